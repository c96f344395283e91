"""The signal model: from the stage's motion to the samples, with all known causes of error.

What to use when: `gain_matrix` and `low_pass` for the sensor; `signal_state` for the signal at each
stage of the signal path; `term` for the interface of a cause, `term_kinds` for its base classes,
`causes` for the causes themselves and `catalogue` to find them; `leveling` for the tilt zero.
"""
