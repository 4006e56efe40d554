"""What a sensor's noise is, by the Allan variance of a standstill."""
