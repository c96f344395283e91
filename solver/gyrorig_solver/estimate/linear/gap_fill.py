"""Missing rows of a signal, predicted from its used rows.

The whitening needs a value at every row. A zero at a missing row would spread the slow noise of the
neighbours over all frequencies, and the fit would then trust rates that wander with the bias. The
missing rows are therefore the most likely values of the noise at its used neighbours (kriging).
The same linear operation acts on the residual and on all derivatives, so that no parameter changes
by it. For white noise, the most likely value is zero, which adds no information.

What to use when: `gap_fill` for the rows of one part; `GapFill.fill` before each whitening;
`GapFill.adjoint` for a product with signals that are not filled.

Source: N. Cressie, Statistics for Spatial Data, Wiley 1993, section 3.2 (simple kriging); the
generalised least squares of incomplete data in R. Little and D. Rubin, Statistical Analysis with
Missing Data, 3rd edition, Wiley 2019, section 2.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
from scipy.fft import irfft
from scipy.sparse import csr_array

from gyrorig_solver.data import BoolArray, FloatArray, IntArray, RealArray
from gyrorig_solver.estimate.noise.missing_samples import has_gaps
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, Sampling

NEIGHBOURS = 16  # used rows that predict a missing one, half of them before it
MAX_DISTANCE = 1000  # rows to the nearest used one; a row beyond it stays zero
BATCH = 2048  # missing rows whose weights are computed together
NUGGET = 1e-9  # of the variance, so that a narrow low-pass gives a regular matrix
# step of the logarithm of the levels, so that small changes of the noise keep the weights
LOG_LEVEL_STEP = 0.5
MIN_RATIO = 1e-30

SignalArray = TypeVar("SignalArray", FloatArray, RealArray)


@dataclass(frozen=True, slots=True, eq=False)
class GapFill:
    """Weights of the used rows that predict each missing row."""

    unused: IntArray  # (u,), the missing rows
    weights: csr_array  # (u, n)

    def fill(self, signals: SignalArray) -> SignalArray:
        """Return signals (..., n), zero at the missing rows, with these rows predicted."""
        filled: SignalArray = signals.copy()
        flat = filled.reshape(-1, signals.shape[-1])
        flat[:, self.unused] = (self.weights @ flat.T).T
        return filled

    def adjoint(self, signals: FloatArray) -> FloatArray:
        """Return signals (..., n) whose products with others equal those with the others filled."""
        flat = signals.reshape(-1, signals.shape[-1])
        result = flat + (self.weights.T @ flat[:, self.unused].T).T
        result[:, self.unused] = 0.0
        return np.asarray(result.reshape(signals.shape), dtype=np.float64)


def gap_fill(used: BoolArray, noise: NoiseModel) -> GapFill | None:
    """Return the prediction of the missing rows of a part; None if it has no gaps.

    Args:
        used: which rows are used, (n,).
        noise: of the rows; all axes have the same weights, those of their mean noise.
    """
    if not has_gaps(used):
        return None
    return _cached_fill(used.tobytes(), noise.sampling, _noise_shape(noise))


def _noise_shape(noise: NoiseModel) -> tuple[float, ...]:
    """Return the logarithms of the slow levels and of the flat density over the white noise."""
    white = np.maximum(noise.levels[:, :1], MIN_RATIO)
    ratios = np.column_stack([noise.levels[:, 1:], noise.flat_density]) / white
    logs = np.log(np.maximum(ratios.mean(axis=0), MIN_RATIO))
    return tuple((LOG_LEVEL_STEP * np.round(logs / LOG_LEVEL_STEP)).tolist())


@lru_cache(maxsize=32)
def _cached_fill(used_bytes: bytes, sampling: Sampling, log_ratios: tuple[float, ...]) -> GapFill:
    used = np.frombuffer(used_bytes, dtype=np.bool_)
    flicker, walk, angle, flat = np.exp(log_ratios)
    levels = np.tile([1.0, flicker, walk, angle], (3, 1))
    noise = NoiseModel(levels, sampling).with_flat_density(np.full(3, flat))
    variance = noise.dct_variance(used.size)[:, 0]
    covariance = irfft(np.append(variance, variance[-1]))[: used.size]
    return _kriging_weights(used, np.asarray(covariance, dtype=np.float64))


def _kriging_weights(used: BoolArray, covariance: FloatArray) -> GapFill:
    rows, unused = np.flatnonzero(used), np.flatnonzero(~used)
    count = min(NEIGHBOURS, rows.size)
    position = np.searchsorted(rows, unused)
    before = rows[np.maximum(position - 1, 0)]
    after = rows[np.minimum(position, rows.size - 1)]
    near = np.minimum(np.abs(unused - before), np.abs(after - unused)) <= MAX_DISTANCE
    first = np.clip(position[near] - count // 2, 0, rows.size - count)
    neighbours = rows[first[:, None] + np.arange(count)]
    targets = unused[near]
    weights = np.zeros(neighbours.shape)
    nugget = NUGGET * covariance[0] * np.eye(count)
    for begin in range(0, targets.size, BATCH):
        batch = slice(begin, begin + BATCH)
        places = neighbours[batch]
        between = covariance[np.abs(places[:, :, None] - places[:, None, :])] + nugget
        to_target = covariance[np.abs(places - targets[batch, None])]
        weights[batch] = np.linalg.solve(between, to_target[:, :, None])[:, :, 0]
    shape: Any = (unused.size, used.size)
    target_rows = np.repeat(np.flatnonzero(near), count)
    return GapFill(unused, csr_array((weights.ravel(), (target_rows, neighbours.ravel())), shape))
