"""The calibration method of the paper, for comparison only.

What to use when: `paper_method.calibrate_as_printed`; `paper_angles` and `paper_matrices` have its
equations.
"""
