"""Checks of a model after the search, and the tests that they use.

What to use when: `model_check` has the signature of a check and runs the checks in order. There is
one check per file: `specification_tests`, `shared_covariate`, `unobservable_share` and `redundancy`
remove names; `jitter_cause`, `ramp_check` and `random_walk` name causes that the mean of the
residual does not show. `residual_dependence` tests the residual; `typical_noise` separates a bias
random walk from slow errors.
"""
