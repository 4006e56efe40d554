"""Mechanization: sensor samples become position, velocity and attitude."""
