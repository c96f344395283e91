"""The type B uncertainty of a calibration: causes that were not identified.

What to use when: `uncertainty_budget.assess_uncertainty` at a fit; `uncertainty_settings` for the
prior sizes of the causes and the limits of the verdict; `marginal_covariance` for the algebra.
"""
