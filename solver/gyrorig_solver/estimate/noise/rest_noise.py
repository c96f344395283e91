"""The noise at rest as a check of the fitted noise levels.

A large unmodelled effect increases the residual in motion. In recordings with short rests, the
levels are fitted to the whole residual. Such an effect then becomes flicker, and the white noise
disappears. Differences of successive samples at rest contain neither.

What to use when: `RestDifferences.of` for the residuals; `limit_to_rest` for fitted levels.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.noise.noise_levels import nominal_levels
from gyrorig_solver.estimate.noise.noise_model import (
    NoiseModel,
    Sampling,
    quantum_density,
    unit_densities,
)

MIN_PAIRS = 200  # of successive samples at rest
# larger of the ratios of the fitted white noise and that at rest, and its inverse
MAX_POWER_RATIO = 4.0
# The same for an axis that the previous step of a fit has limited. If both were equal, a ratio near
# the limit could make the fit alternate between two sets of levels without an end.
RELEASE_POWER_RATIO = 2.0
FREQUENCY_BINS = 500


@dataclass(frozen=True, slots=True, eq=False)
class RestDifferences:
    """Differences of successive block means at rest."""

    sum_of_squares: FloatArray  # (3,)
    count: int
    order: int = 1  # 2: differences of differences, and so on

    @classmethod
    def of(
        cls, residuals: Sequence[FloatArray], at_rest: Sequence[BoolArray], order: int = 1
    ) -> "RestDifferences":
        """Return the differences of successive blocks that are all at rest.

        Args:
            residuals: of each series, (n, 3).
            at_rest: of each series, (n,), without the time in which the unit settles.
            order: of the differences.
        """
        total, count = np.zeros(3), 0
        for residual, rest in zip(residuals, at_rest, strict=True):
            if rest.size <= order:
                continue
            all_rest = np.all(sliding_window_view(rest, order + 1), axis=1)
            total += np.sum(np.diff(residual, order, axis=0)[all_rest] ** 2, axis=0)
            count += int(all_rest.sum())
        return cls(total, count, order)

    def predict_power(self, noise: NoiseModel) -> FloatArray:
        """Return the mean square of the differences that a noise model predicts, shape (3,)."""
        frequency_hz, response = _difference_response(noise.sampling, self.order)
        power = response @ noise.density(frequency_hz) * _bin_width_hz(noise.sampling)
        return np.asarray(power, dtype=np.float64)

    @property
    def power(self) -> FloatArray:
        """The mean square of the differences, shape (3,)."""
        return self.sum_of_squares / max(self.count, 1)


def limit_to_rest(
    noise: NoiseModel, differences: RestDifferences, previous_levels: FloatArray | None = None
) -> NoiseModel:
    """Return the noise; if it contradicts the noise at rest, use the levels of an ordinary part.

    An axis is contradictory if its fitted white noise differs from that at rest by more than
    `MAX_POWER_RATIO`. It then gets the white noise at rest, and the flicker and random walk of an
    ordinary part with this white noise.

    Args:
        noise: fitted to the residual.
        differences: at rest.
        previous_levels: (3, 4), of the previous step of the same fit.
    """
    if differences.count < MIN_PAIRS or noise.sampling.differentiated:
        return noise
    nominal = _ordinary_levels()
    rate_hz = noise.sampling.rate_hz
    quantum_power = quantum_density(noise.sampling) * rate_hz
    flat_power = noise.floor_and_rounding * rate_hz * (1.0 + noise.incomplete[4])
    unit_powers = _unit_difference_power(noise.sampling) + rate_hz * noise.incomplete[:4]
    unit_power = float(nominal @ unit_powers)
    white_at_rest = np.maximum(differences.power - flat_power, quantum_power) / unit_power
    log_ratio = np.log(np.maximum(noise.levels[:, 0], 1e-300) / white_at_rest)
    max_ratio = np.where(_are_limited(previous_levels), RELEASE_POWER_RATIO, MAX_POWER_RATIO)
    contradicts = np.abs(log_ratio) > np.log(max_ratio)
    if not contradicts.any():
        return noise
    levels = np.where(contradicts[:, None], white_at_rest[:, None] * nominal, noise.levels)
    return replace(noise, levels=levels)


def _ordinary_levels() -> FloatArray:
    """Return the levels of an ordinary part with the white noise 1, shape (4,)."""
    levels = nominal_levels(1.0)
    levels[3] = 0.0  # only for attitudes
    return levels


def _are_limited(levels: FloatArray | None) -> BoolArray:
    """Return which axes have levels that `limit_to_rest` has set, shape (3,)."""
    if levels is None:
        return np.zeros(3, np.bool_)
    return np.asarray(np.all(levels == levels[:, :1] * _ordinary_levels(), axis=1))


def _unit_difference_power(sampling: Sampling) -> FloatArray:
    """Return the mean square of differences of successive blocks by each unit process, (4,)."""
    frequency_hz, response = _difference_response(sampling, 1)
    return np.asarray(unit_densities(frequency_hz, sampling) @ response * _bin_width_hz(sampling))


def _difference_response(sampling: Sampling, order: int) -> tuple[FloatArray, FloatArray]:
    """Return frequencies and the power gain of differences of successive blocks, (k,) each."""
    bins = np.arange(FREQUENCY_BINS) + 0.5
    frequency_hz = np.asarray(bins * _bin_width_hz(sampling), dtype=np.float64)
    first = 4.0 * np.sin(np.pi * frequency_hz / sampling.rate_hz) ** 2
    return frequency_hz, np.asarray(first**order, dtype=np.float64)


def _bin_width_hz(sampling: Sampling) -> float:
    return sampling.rate_hz / 2.0 / FREQUENCY_BINS
