"""Comparison of statements with hidden causes: outcomes, figures with exact limits, goals."""
