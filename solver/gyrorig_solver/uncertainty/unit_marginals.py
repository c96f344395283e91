"""A fit combined with the posterior that earlier recordings gave for the unit.

The unknowns are the sizes of the causes that the fit left out, c, and the fitted sizes of
persistent causes, f. The fit gives f_hat = f + A_f' c + noise with covariance C_f, and, orthogonal
to its own parameters, information F and score s on c. With the unit's posterior as the prior on the
persistent sizes, and N(0, 1) in units of the table on all others, the posterior of (c, f) follows.
The fit's parameters depend on it linearly:

    p = p_hat - A' c + K (f - f_hat + A_f' c),     K = cov(p_hat, f_hat) C_f^-1

The stated values are corrected by the persistent sizes only; decision 0044 gives the reason.

What to use when: `UnitMarginals.of` for the combination; `unit_information` for the information
that the recording adds to the unit's posterior.

Source: Schmidt, Advances in Control Systems 3 (1966) 293; JCGM 100:2008, F.2.4.5.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.numerics import positive_part, posterior_covariance
from gyrorig_solver.uncertainty.fit_linearisation import FitLinearisation
from gyrorig_solver.uncertainty.unit_values import UnitInformation, UnitPosterior


@dataclass(frozen=True, slots=True, eq=False)
class UnitMarginals:
    """The fit's parameters after the unit's posterior was applied."""

    shift: FloatArray  # (q,), correction of the fit's parameters
    noise_covariance: FloatArray  # (q, q), type A, of the corrected parameters
    total_covariance: FloatArray  # (q, q), of the parameters given data and priors
    expected_error: FloatArray  # (q,), of the corrected parameters, by causes not corrected for
    size_covariance: FloatArray  # (c + f, c + f)
    size_mean: FloatArray  # (c + f,), 0 for the sizes that were corrected for
    derivative: FloatArray  # (q, c + f), of the parameters by the sizes
    applied: FloatArray  # (q,), part of the shift that follows from the mean of the unit's sizes

    @classmethod
    def of(cls, fit: FitLinearisation, prior: UnitPosterior) -> Self:
        """Combine a fit with the posterior of its unit."""
        information, score = fit.data_terms()
        prior_covariance, prior_mean = size_prior(fit, prior)
        covariance = posterior_covariance(information, prior_covariance)
        mean = prior_mean + covariance @ (score - information @ prior_mean)
        derivative, regression = fit.parameter_terms()
        is_unit = fit.unit_position >= 0
        applied = derivative * is_unit
        shift = applied @ mean - regression @ fit.fitted_values
        residual_noise = regression @ (fit.covariance + fit.prior_covariance)[fit.fitted]
        return cls(
            shift=shift,
            noise_covariance=_noise_covariance(fit, applied @ covariance, regression),
            total_covariance=fit.covariance
            - residual_noise
            + derivative @ covariance @ derivative.T,
            expected_error=-(derivative * ~is_unit) @ mean,
            size_covariance=covariance,
            size_mean=np.where(is_unit, 0.0, mean),
            derivative=derivative,
            applied=applied @ mean,
        )


def unit_information(fit: FitLinearisation, unit_size_count: int) -> UnitInformation:
    """Return the information of a fit on the unit's sizes, with all other causes marginalised.

    Args:
        fit: the fit.
        unit_size_count: number of the unit's sizes.
    """
    information, score = fit.data_terms()
    unit = np.flatnonzero(fit.unit_position >= 0)
    other = np.flatnonzero(fit.unit_position < 0)
    cross = information[np.ix_(unit, other)]
    weight = np.linalg.solve(
        information[np.ix_(other, other)] + np.eye(other.size),
        np.column_stack([cross.T, score[other]]),
    )
    reduced = information[np.ix_(unit, unit)] - cross @ weight[:, :-1]
    reduced_score = score[unit] - cross @ weight[:, -1]
    scale, position = fit.unit_scale[unit], fit.unit_position[unit]
    matrix, vector = np.zeros((unit_size_count, unit_size_count)), np.zeros(unit_size_count)
    matrix[np.ix_(position, position)] = positive_part(reduced) / np.outer(scale, scale)
    vector[position] = reduced_score / scale
    return UnitInformation(matrix, vector)


def size_prior(fit: FitLinearisation, prior: UnitPosterior) -> tuple[FloatArray, FloatArray]:
    """Return covariance and mean of all sizes before the recording, in the units of the fit."""
    unit = np.flatnonzero(fit.unit_position >= 0)
    position, scale = fit.unit_position[unit], fit.unit_scale[unit]
    covariance, mean = np.eye(len(fit.unit_position)), np.zeros(len(fit.unit_position))
    covariance[np.ix_(unit, unit)] = prior.covariance[np.ix_(position, position)] / np.outer(
        scale, scale
    )
    mean[unit] = prior.mean[position] / scale
    return covariance, mean


def _noise_covariance(
    fit: FitLinearisation, gain: FloatArray, regression: FloatArray
) -> FloatArray:
    """Return the covariance of the corrected parameters from the noise of the data alone.

    Args:
        fit: the fit.
        gain: change of the parameters by the score of all sizes, (q, c + f).
        regression: K, (q, f).
    """
    left_out = len(fit.score)
    by_parameters = np.eye(len(fit.covariance))
    size_score_by_values = fit.fitted_design().T @ fit.fitted_weight()
    by_parameters[:, fit.fitted] += gain @ size_score_by_values - regression
    by_score = gain[:, :left_out]
    noise = by_parameters @ fit.covariance @ by_parameters.T
    return np.asarray(noise + by_score @ fit.information @ by_score.T, dtype=np.float64)
