"""The fit to reference attitudes, such as motion capture.

What to use when: `attitude_summary.fit_attitude` for a calibration; `attitude_projector` for score
tests at that fit.
"""
