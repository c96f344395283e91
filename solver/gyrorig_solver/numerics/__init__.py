"""Numerical tools without any physics: probability distributions and structured linear algebra.

What to use when: `distributions` for p-values and limits, `arrowhead` for information matrices
with many local and a few shared unknowns.
"""
