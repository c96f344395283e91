"""gyrorig_daemon."""
