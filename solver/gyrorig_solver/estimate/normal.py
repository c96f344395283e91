"""The whitened normal equations of one series, without ever forming a dense Jacobian.

Model of axis i: y_i = G_i . omega(t - tau) + b_i + noise. Unknowns: G (9, row by row),
b (3), tau, then the reference's shared unknowns, then its local ones (one start to a
move). Weighing is V_i^-1 = D' diag(1/variance_i) D with D the orthonormal DCT. Signals
that act everywhere are transformed once; a local column touches the others only inside
its own stretch, through V_i^-1 applied to them, and its neighbours through a window's
own small DCT, so the cost grows with the length and not with length times moves.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import dct, idct, next_fast_len

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.estimate.noise import NoiseModel
from gyrorig_solver.estimate.series import Predicted, Series

WINDOW_S = 1.0  # how far beyond a local column its weighing reaches


@dataclass(frozen=True, slots=True, eq=False)
class BlockModel:
    """Measured and predicted block means of one series, at one set of parameters."""

    measured: FloatArray  # (n, 3)
    rate: FloatArray  # (n, 3)
    slope: FloatArray  # (n, 3)
    shared: FloatArray  # (g, n, 3)
    local_first: list[int]
    local: list[FloatArray]  # (m, 3) each
    used: BoolArray  # (n,)

    def residual(self, gain: FloatArray, bias: FloatArray) -> FloatArray:
        """Return measured minus modelled, zero where unused, shape (n, 3)."""
        left = self.measured - self.rate @ gain.T - bias
        return np.where(self.used[:, None], left, 0.0)


def block_model(series: Series, predicted: Predicted, use: BoolArray) -> BlockModel:
    """Return block means over the samples in `use`, which are good and have a reference."""
    measured, used = series.block_means(series.rate_rad_s, use)
    rate, _ = series.block_means(predicted.rate, use)
    slope, _ = series.block_means(predicted.slope, use)
    shared, _ = series.block_means(predicted.shared, use)
    first, local = [], []
    for column in predicted.local:
        begin = column.first // series.block
        stop = min(series.blocks, -(-(column.first + column.values.shape[0]) // series.block))
        whole = np.zeros((max(0, stop - begin) * series.block, 3))
        offset = column.first - begin * series.block
        room = max(0, whole.shape[0] - offset)
        values = column.values[:room]
        whole[offset : offset + values.shape[0]] = values
        keep = use[begin * series.block : begin * series.block + whole.shape[0], None]
        shaped = np.where(keep, whole, 0.0).reshape(-1, series.block, 3)
        count = np.maximum(keep.reshape(-1, series.block).sum(axis=1), 1)
        first.append(begin)
        local.append(shaped.sum(axis=1) / count[:, None])
    return BlockModel(measured, rate, slope, shared, first, local, used)


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """Information and score over (G, b, tau, shared, local)."""

    information: FloatArray
    score: FloatArray

    def __add__(self, other: "Normal") -> "Normal":
        """Add the evidence of another series."""
        return Normal(self.information + other.information, self.score + other.score)


def normal_equations(
    model: BlockModel, gain: FloatArray, residual: FloatArray, noise: NoiseModel
) -> Normal:
    """Return the normal equations of one series at the current parameters.

    Args:
        model: block means at the current reference and lag.
        gain: G, shape (3, 3).
        residual: shape (n, 3), zero where unused.
        noise: density of the residual.
    """
    n = residual.shape[0]
    shared_count, local_count = model.shared.shape[0], len(model.local)
    size = 13 + shared_count + local_count
    information, score = np.zeros((size, size)), np.zeros(size)
    used = model.used[:, None].astype(np.float64)
    stage = np.concatenate(
        [model.rate * used, used, -model.slope * used, *(s * used for s in model.shared)], axis=1
    )
    spectrum = dct(stage, axis=0, norm="ortho")
    left = dct(residual, axis=0, norm="ortho")
    variance = noise.variance(n)
    variances: dict[int, FloatArray] = {}
    for axis in range(3):
        row = gain[axis]
        columns = np.empty((n, 5 + shared_count))
        columns[:, :4] = spectrum[:, :4]
        columns[:, 4] = spectrum[:, 4:7] @ row
        for g in range(shared_count):
            columns[:, 5 + g] = spectrum[:, 7 + 3 * g : 10 + 3 * g] @ row
        index = np.concatenate(
            [[3 * axis, 3 * axis + 1, 3 * axis + 2, 9 + axis, 12], 13 + np.arange(shared_count)]
        )
        weighed = columns / variance[:, axis, None]
        information[np.ix_(index, index)] += weighed.T @ columns
        score[index] += weighed.T @ left[:, axis]
        if local_count:
            back = idct(
                np.column_stack([weighed, left[:, axis] / variance[:, axis]]),
                axis=0,
                norm="ortho",
            )
            _local(model, row, axis, noise, back, index, information, score, variances)
    return Normal(information, score)


def _local(
    model: BlockModel,
    row: FloatArray,
    axis: int,
    noise: NoiseModel,
    back: FloatArray,
    index: FloatArray,
    information: FloatArray,
    score: FloatArray,
    variances: dict[int, FloatArray],
) -> None:
    """Add the local columns' share of one axis; `variances` keeps what windows need."""
    n = back.shape[0]
    base = 13 + model.shared.shape[0]
    reach = max(4, round(WINDOW_S * noise.sampling.rate_hz))
    stretches = [
        (first, values @ row) for first, values in zip(model.local_first, model.local, strict=True)
    ]
    starts = np.array([first for first, _ in stretches])
    stops = starts + np.array([values.size for _, values in stretches])
    for k, (first, values) in enumerate(stretches):
        if not values.any():
            continue
        inside = slice(first, first + values.size)
        cross = values @ back[inside]
        information[base + k, index] += cross[:-1]
        information[index, base + k] += cross[:-1]
        score[base + k] += cross[-1]
        size = min(n, next_fast_len(values.size + 2 * reach))
        begin = min(max(0, first - reach), n - size)
        end = begin + size
        window = np.zeros(size)
        window[first - begin : first - begin + values.size] = values
        if size not in variances:
            variances[size] = noise.variance(size)
        spread = dct(window, norm="ortho") / variances[size][:, axis]
        weighed = idct(spread, norm="ortho")
        # Most columns are far from each other where there are many.
        for other in k + np.flatnonzero((starts[k:] < end) & (stops[k:] > begin)):
            start, theirs = stretches[other]
            low, high = max(begin, start), min(end, start + theirs.size)
            value = float(weighed[low - begin : high - begin] @ theirs[low - start : high - start])
            information[base + k, base + other] += value
            if other != k:
                information[base + other, base + k] += value
