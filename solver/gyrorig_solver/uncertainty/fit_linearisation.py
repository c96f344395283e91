"""A fit as a linear model of cause sizes: those left out and the fitted persistent ones.

What to use when: `linearise_fit` turns a fit into the input of `unit_marginals`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.estimate import (
    GAIN_PARAMETERS,
    SESSION_PARAMETERS,
    ConvergedFit,
    ScoreStatistics,
    widen_uncertainty,
)
from gyrorig_solver.model import value_indices
from gyrorig_solver.uncertainty.prior_effects import UnidentifiedCause
from gyrorig_solver.uncertainty.uncertainty_settings import UncertaintySettings
from gyrorig_solver.uncertainty.unit_values import (
    fitted_unit_values,
    table_covariance,
    unit_value_position,
)


@dataclass(frozen=True, slots=True, eq=False)
class FitLinearisation:
    """A fit as a linear model of the sizes of causes.

    Sizes that the fit left out are in units of their prior from the table, fitted sizes in SI.
    """

    information: FloatArray  # (c, c), F, of the sizes that were left out
    score: FloatArray  # (c,), s
    influence: FloatArray  # (c, q), A: change of the fit's parameters by each of these sizes
    covariance: FloatArray  # (q, q), of the fit's parameters, from noise
    # (q, q), of the prior in the directions that the data do not determine
    prior_covariance: FloatArray
    fitted: IntArray  # (f,), positions of the fitted persistent sizes among the q parameters
    fitted_values: FloatArray  # (f,)
    # (c + f,), among the unit's sizes; -1 for a size that is not of the unit
    unit_position: IntArray
    unit_scale: FloatArray  # (c + f,), SI value of one unit of each size

    def data_terms(self) -> tuple[FloatArray, FloatArray]:
        """Return information (c + f, c + f) and score (c + f,) of the data on the sizes."""
        left_out, size = len(self.score), len(self.unit_position)
        information, score = np.zeros((size, size)), np.zeros(size)
        information[:left_out, :left_out] = self.information
        score[:left_out] = self.score
        design = self.fitted_design()
        size_score_by_values = design.T @ self.fitted_weight()
        return (
            information + size_score_by_values @ design,
            score + size_score_by_values @ self.fitted_values,
        )

    def parameter_terms(self) -> tuple[FloatArray, FloatArray]:
        """Return the parameters' derivative by the sizes (q, c + f), and their regression K."""
        joint = self.covariance + self.prior_covariance
        regression = joint[:, self.fitted] @ self.fitted_weight()
        left_out = len(self.score)
        derivative = np.zeros((len(joint), len(self.unit_position)))
        derivative[:, :left_out] = -self.influence.T
        return derivative + regression @ self.fitted_design(), regression

    def fitted_design(self) -> FloatArray:
        """Return the derivative of the fitted sizes by all sizes, (f, c + f)."""
        scale = np.diag(self.unit_scale[len(self.score) :])
        return np.hstack([self.influence[:, self.fitted].T, scale])

    def fitted_weight(self) -> FloatArray:
        """Return the inverse covariance of the fitted sizes, (f, f)."""
        joint = self.covariance + self.prior_covariance
        return np.asarray(np.linalg.inv(joint[np.ix_(self.fitted, self.fitted)]), dtype=np.float64)


def linearise_fit(
    solution: ConvergedFit,
    settings: UncertaintySettings,
    causes: Sequence[UnidentifiedCause],
    statistics: ScoreStatistics,
) -> list[FitLinearisation]:
    """Return each recording's parameters as a linear model of the sizes of causes.

    Args:
        solution: the fit.
        settings: prior sizes; a fitted cause without a prior size counts as not persistent.
        causes: those that the fit left out.
        statistics: their information and score at the fit.
    """
    widened, chi2_factor = widen_uncertainty(solution)
    table_std = np.sqrt(np.diag(table_covariance(settings)))
    positions, scales = sizes_of_signals(causes)
    fitted = [
        entry for entry in fitted_unit_values(solution.fitted_terms) if table_std[entry[1]] > 0.0
    ]
    recordings = len(solution.sessions)
    terms = np.arange(
        GAIN_PARAMETERS + SESSION_PARAMETERS * recordings, statistics.absorbed.shape[1]
    )
    fits = []
    for k, analysis in enumerate(widened.session_observability):
        first = GAIN_PARAMETERS + SESSION_PARAMETERS * k
        rows = [*range(GAIN_PARAMETERS), *range(first, first + SESSION_PARAMETERS), *terms]
        is_last = k == recordings - 1
        stated = widened.observability if is_last else analysis
        if is_last:  # a rest at the end has no time offset
            offset = GAIN_PARAMETERS + SESSION_PARAMETERS * (solution.offset_recording + 1) - 1
            rows[GAIN_PARAMETERS + SESSION_PARAMETERS - 1] = offset
        fits.append(
            FitLinearisation(
                information=statistics.information / chi2_factor,
                score=statistics.score / chi2_factor,
                influence=statistics.absorbed[:, rows],
                covariance=stated.covariance,
                prior_covariance=stated.unobservable_covariance,
                fitted=np.array(
                    [GAIN_PARAMETERS + SESSION_PARAMETERS + entry[0] for entry in fitted],
                    dtype=np.int64,
                ),
                fitted_values=np.array([entry[2] for entry in fitted], dtype=np.float64),
                unit_position=np.array(
                    [*positions, *(entry[1] for entry in fitted)], dtype=np.int64
                ),
                unit_scale=np.array([*scales, *(table_std[entry[1]] for entry in fitted)]),
            )
        )
    return fits


def sizes_of_signals(causes: Sequence[UnidentifiedCause]) -> tuple[list[int], list[float]]:
    """Return the position of each signal among the unit's sizes, -1 for none, and its scale.

    Args:
        causes: those that the fit left out.
    """
    positions, scales = [], []
    for cause in causes:
        sizes = value_indices(cause.term, role="size")
        for _ in cause.templates:
            for position in cause.positions:
                unit_position = unit_value_position(cause.term, sizes[position])
                positions.append(-1 if unit_position is None else unit_position)
                scales.append(cause.prior.std)
    return positions, scales
