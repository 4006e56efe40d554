"""Full IMU and GNSS together: error dynamics, updates, the loosely coupled filter."""
