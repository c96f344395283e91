"""gyrorig_solver."""
