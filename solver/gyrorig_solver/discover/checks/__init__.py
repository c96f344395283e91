"""Tests of named causes and of the residual after a search.

What to use when: `specification_tests`, `nonparametric_dominance` and `backward_elimination`
reject names; `residual_dependence` tests the residual; `typical_noise` and `random_walk` separate
a bias random walk from slow errors; `jitter_cause` and `ramp_acceleration` find two causes
that no mean signal shows; `fit_residual` is for references without a motion.
"""
