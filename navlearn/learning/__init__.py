"""Learning error models: windows, training loops, Levenberg–Marquardt."""
