"""Inertial sensors and GNSS together: error dynamics, measurement updates, the navigation filter."""
