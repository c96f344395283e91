"""Checks of a model after the search, and the tests that they are made of.

What to use when: `model_check` has the signature of a check and runs them in order. One check per
file: `specification_tests`, `unobservable_share` and `redundancy` take names away; `jitter_cause`,
`ramp_check` and `random_walk` name causes that no mean signal shows. `residual_dependence` tests
the residual; `typical_noise` separates a bias random walk from slow errors.
"""
