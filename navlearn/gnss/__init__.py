"""Satellites: orbits, delays of their signals, and positions from ranges alone."""
