"""Drive logs: reading, checking, resampling, simulating."""
