"""What the solver believes of a gyroscope, one file a physical term."""
