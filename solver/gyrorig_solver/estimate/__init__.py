"""The estimators: from samples and a reference motion to gain, bias, delay and causes.

What to use when:

- `motion_fit.fit_motion` and `fit_recordings` for a board on a pan-tilt unit or at rest;
  `multi_board_fit` for several boards that were on one unit at the same time.
- `attitude.attitude_fit`, `turn_fit` and `gravity_fit` for the other references.
- `likelihood_fit` for the fit of one or more boards, `board_fit` for one board, `session_fit` for
  one recording; `parameter_layout` for the order of their parameters.
- `fitted_term` and `cascade` for causes in a fit.
- `nuisance_projector` for score tests at a fit.
- `observability` for what the data determine; `gyro_fit` for the result of every method.
- `noise` for the noise model and outliers, `linear` for the normal equations, `paper` for the
  method of the paper.
"""
