"""Filtering that knows nothing of cars: beliefs, discretisation, Kalman updates, consistency."""
