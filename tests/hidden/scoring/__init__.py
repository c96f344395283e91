"""What was stated beside what was hidden: outcomes, figures with exact limits, goals."""
