"""Test whether two recordings of one board can have the same gain.

Each recording is fitted alone. The solver compares the difference of two gains with its standard
uncertainty. This uncertainty contains the noise, the causes that the recordings cannot exclude, and
the change of the scale factors between two temperatures. Bias and time offset can change between
recordings, so they are not compared.

What to use when: `GainEstimate.of` for the fit of one recording to its motion,
`GainEstimate.of_fit` for a fit to another reference, `compare_gains` for several.

Source: the normalised error of two results, JCGM 100:2008 and ISO 13528, extended to nine
parameters: a chi-squared test of their difference.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Self

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.discover import CALIBRATION_PARAMETERS, CalibrationValues
from gyrorig_solver.discover.calibration_changes import CALIBRATION_UNITS
from gyrorig_solver.estimate import (
    GAIN_PARAMETERS,
    SESSION_PARAMETERS,
    ConvergedFit,
    GyroFit,
    widen_uncertainty,
)
from gyrorig_solver.model import find_term
from gyrorig_solver.numerics import chi2_upper_tail, score_statistic
from gyrorig_solver.uncertainty.uncertainty_budget import UncertaintyBudget, assess_uncertainty
from gyrorig_solver.uncertainty.uncertainty_settings import default_settings

MIN_AGREEMENT_P = 1e-6  # p-value of a pair of recordings, divided by the number of pairs
SCALES = slice(0, 3)  # of the parameters
# of the correlation matrix; directions with less variance are not compared
MIN_RELATIVE_VARIANCE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class GainEstimate:
    """The nine gain parameters of one recording, in the order of `CALIBRATION_PARAMETERS`."""

    name: str  # of the recording
    values: FloatArray  # (9,)
    covariance: FloatArray  # (9, 9)
    is_known: BoolArray  # (9,), False if the data do not determine the parameter
    temperature_degc: float = float("nan")  # mean of the recording

    @classmethod
    def of(cls, name: str, solution: ConvergedFit, with_causes: bool) -> Self:
        """Return the gain of a fit.

        Args:
            name: of the recording.
            solution: the fit of this recording alone.
            with_causes: whether the uncertainty includes causes that the fit has not identified.
        """
        widened, _ = widen_uncertainty(solution)
        calibration = CalibrationValues.of(widened)
        base = slice(0, GAIN_PARAMETERS + SESSION_PARAMETERS)
        covariance = (
            calibration.jacobian
            @ widened.observability.covariance[base, base]
            @ calibration.jacobian.T
        )
        if with_causes:
            covariance = covariance + _cause_covariance(assess_uncertainty(solution))
        context = solution.sessions[-1].context
        temperature = None if context is None else context.temperature
        return cls(
            name,
            calibration.values[:GAIN_PARAMETERS],
            covariance[:GAIN_PARAMETERS, :GAIN_PARAMETERS],
            np.isfinite(calibration.std[:GAIN_PARAMETERS]),
            float("nan") if temperature is None else temperature.mean_degc,
        )

    @classmethod
    def of_fit(
        cls,
        name: str,
        fit: GyroFit,
        budget: UncertaintyBudget | None = None,
        temperature_degc: float = float("nan"),
    ) -> Self:
        """Return the gain of a fit to a reference that does not give the rate at each time.

        Args:
            name: of the recording.
            fit: of this recording alone.
            budget: of the causes that the fit has not identified; None: they are left out.
            temperature_degc: mean of the recording, NaN if it is not known.
        """
        names = CALIBRATION_PARAMETERS[:GAIN_PARAMETERS]
        is_known = np.array([np.isfinite(fit.std.get(key, np.nan)) for key in names])
        covariance = np.zeros((GAIN_PARAMETERS, GAIN_PARAMETERS))
        rows = np.flatnonzero(is_known)
        stated = [fit.order.index(names[k]) for k in rows]
        covariance[np.ix_(rows, rows)] = fit.covariance[np.ix_(stated, stated)]
        if budget is not None:
            covariance += _cause_covariance(budget)[:GAIN_PARAMETERS, :GAIN_PARAMETERS]
        values = np.array([fit.value(key) for key in names])
        return cls(name, values, covariance, is_known, temperature_degc)

    def widened_by_rate(self, rate_range_rad_s: tuple[float, float]) -> Self:
        """Return the estimate with the prior sizes of scale errors that depend on the rate.

        Two recordings at different rates can have different scale factors. A fit to the angle of
        each turn does not show such a cause, therefore its whole prior size counts.

        Args:
            rate_range_rad_s: smallest and largest rate of the recording.
        """
        largest_rad_s = max(map(abs, rate_range_rad_s))
        prior_sizes = default_settings().prior_sizes
        variance = sum(
            (prior.std * largest_rad_s**power) ** 2
            for cause, prior in prior_sizes.items()
            if (power := find_term(cause).scale_rate_power) is not None
        )
        covariance = self.covariance.copy()
        covariance[SCALES, SCALES] += variance * np.eye(3)
        return replace(self, covariance=covariance)


@dataclass(frozen=True, slots=True)
class GainDisagreement:
    """Two recordings whose gains differ by more than their uncertainty."""

    first: str
    second: str
    parameter: str  # with the largest difference relative to its standard uncertainty
    difference: float  # second minus first, in `unit`
    unit: str
    sigma: float  # standard uncertainties of the difference
    p_value: float  # of all parameters
    degrees: int  # number of compared directions


def compare_gains(estimates: Sequence[GainEstimate]) -> GainDisagreement | None:
    """Return the pair of recordings that disagrees most, None if all agree."""
    pairs = list(combinations(estimates, 2))
    disagreements = [_compare_pair(first, second) for first, second in pairs]
    significant = [
        disagreement
        for disagreement in disagreements
        if disagreement is not None and disagreement.p_value * len(pairs) < MIN_AGREEMENT_P
    ]
    return min(
        significant,
        key=lambda disagreement: (disagreement.p_value, -disagreement.sigma),
        default=None,
    )


def _compare_pair(first: GainEstimate, second: GainEstimate) -> GainDisagreement | None:
    """Compare the parameters that both recordings determine; None if there are none."""
    known = np.flatnonzero(first.is_known & second.is_known)
    if not known.size:
        return None
    difference = (second.values - first.values)[known]
    covariance = first.covariance + second.covariance + _temperature_covariance(first, second)
    covariance = covariance[np.ix_(known, known)]
    std = np.sqrt(np.diag(covariance))
    statistic, degrees = score_statistic(
        covariance / np.outer(std, std), difference / std, MIN_RELATIVE_VARIANCE, largest=1.0
    )
    worst = int(np.argmax(np.abs(difference) / std))
    return GainDisagreement(
        first=first.name,
        second=second.name,
        parameter=CALIBRATION_PARAMETERS[known[worst]],
        difference=float(difference[worst]),
        unit=CALIBRATION_UNITS[known[worst]],
        sigma=float(abs(difference[worst]) / std[worst]),
        p_value=chi2_upper_tail(statistic, degrees),
        degrees=degrees,
    )


def _cause_covariance(budget: UncertaintyBudget) -> FloatArray:
    """Return the type B covariance; the expected error is not corrected, so its square counts."""
    return np.asarray(
        budget.covariance + np.outer(budget.expected_error, budget.expected_error), np.float64
    )


def _temperature_covariance(first: GainEstimate, second: GainEstimate) -> FloatArray:
    """Return the covariance from the change of scale factors between two temperatures, (9, 9)."""
    covariance = np.zeros((GAIN_PARAMETERS, GAIN_PARAMETERS))
    change_degc = second.temperature_degc - first.temperature_degc
    if np.isfinite(change_degc):
        prior_sizes = default_settings().prior_sizes
        variance = sum(
            (prior.size * change_degc) ** 2
            for cause, prior in prior_sizes.items()
            if find_term(cause).scale_follows_temperature
        )
        np.fill_diagonal(covariance[SCALES, SCALES], variance)
    return covariance
