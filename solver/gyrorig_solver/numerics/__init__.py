"""Numerical tools without any physics: probability distributions and structured linear algebra.

What to use when: `distributions` for p-values and limits, `arrowhead` for information matrices
with many local and a few shared unknowns, `information_matrices` for dense ones.
"""

from gyrorig_solver.numerics.arrowhead import ArrowheadMatrix, eliminate_local, solve_arrowhead
from gyrorig_solver.numerics.distributions import (
    chi2_noncentrality,
    chi2_quantile,
    chi2_upper_tail,
    f_quantile,
    f_upper_tail,
    normal_quantile,
    normal_score,
    normal_upper_tail,
    student_factor,
)
from gyrorig_solver.numerics.information_matrices import (
    positive_part,
    posterior_covariance,
    score_statistic,
)

__all__ = [
    "ArrowheadMatrix",
    "chi2_noncentrality",
    "chi2_quantile",
    "chi2_upper_tail",
    "eliminate_local",
    "f_quantile",
    "f_upper_tail",
    "normal_quantile",
    "normal_score",
    "normal_upper_tail",
    "positive_part",
    "posterior_covariance",
    "score_statistic",
    "solve_arrowhead",
    "student_factor",
]
