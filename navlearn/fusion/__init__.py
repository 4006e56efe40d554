"""Inertial sensors and GNSS together: error dynamics, updates, the navigation filter."""
