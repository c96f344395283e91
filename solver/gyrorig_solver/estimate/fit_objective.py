"""The objective of a fit: negative log-likelihood of the residual, and the reference's prior.

Only differences are evaluated, at the noise of the normal equations, and over blocks that both fits
use. Blocks can be left out because a cause makes their timing uncertain. Outliers are determined
after a step is accepted, so that a step cannot decrease the objective by rejecting samples.

What to use when: `residual_decrease` for one recording before and after a step, and
`executed_motion.reference_decrease` for its reference. Boards on one unit share the reference, so
its prior counts once.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.linear.gap_fill import gap_fill
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, dct_frequencies_hz
from gyrorig_solver.estimate.noise.relative_std import (
    RelativeStd,
    mean_white_power,
    orthonormal_dct,
)
from gyrorig_solver.estimate.series import Series
from gyrorig_solver.estimate.session_fit import SessionFit


def residual_decrease(
    before: SessionFit, after: SessionFit, gain_before: FloatArray, gain_after: FloatArray
) -> float:
    """Return the decrease of one recording's negative log-likelihood by a step, in nats.

    Args:
        before: at the last normal equations.
        after: after `SessionFit.predict`.
        gain_before: G, shape (3, 3).
        gain_after: the same after the step.
    """
    noise = before.derivatives.equation_noise
    if noise is None:
        raise ValueError("the recording has no normal equations yet")
    total = 0.0
    series_before = zip(before.series, before.used, before.residuals(gain_before), strict=True)
    series_after = zip(after.used, after.residuals(gain_after), strict=True)
    for index, ((series, used_before, residual_before), (used_after, residual_after)) in enumerate(
        zip(series_before, series_after, strict=True)
    ):
        if np.array_equal(used_before, used_after):
            pair = residual_before, residual_after
        else:
            pair = (
                np.where(used_after[:, None], residual_before, 0.0),
                np.where(used_before[:, None], residual_after, 0.0),
            )
        stds = [before.relative_std(index, blocks) for blocks in series.part_slices()]
        used = used_before & used_after
        total += residual_cost(series, pair[0], used, noise, stds)
        total -= residual_cost(series, pair[1], used, noise, stds)
    return total


def residual_cost(
    series: Series,
    residual: FloatArray,
    used: BoolArray,
    noise: NoiseModel,
    relative_stds: Sequence[RelativeStd | None],
) -> float:
    """Return half the squared norm of a series' whitened residual, in nats.

    The parts of a long series are whitened separately, and their constants together, as in
    `linear.normal_equations`.

    Args:
        series: the series.
        residual: zero where unused, shape (n, 3).
        used: which rows are used, (n,).
        noise: at rest.
        relative_stds: of each part's noise.
    """
    parts = series.part_slices()
    constants: list[FloatArray] = []
    total = 0.0
    for blocks, relative_std in zip(parts, relative_stds, strict=True):
        signals = np.ascontiguousarray(residual[blocks].T)
        fill = gap_fill(used[blocks], noise)
        spectrum = orthonormal_dct(signals if fill is None else fill.fill(signals))
        variance = noise.dct_variance(spectrum.shape[1]).T
        first = 0 if len(parts) == 1 else 1
        if relative_std is None:
            total += float(np.sum(spectrum[:, first:] ** 2 / variance[:, first:]))
        else:
            white = relative_std.divide_spectra(spectrum / np.sqrt(variance))
            total += float(np.sum(white[:, first:] ** 2))
        constants.append(spectrum[:, 0])
    if len(parts) > 1:
        white_power = mean_white_power(relative_stds)
        total += _constants_cost(constants, residual.shape[0], noise, white_power)
    return 0.5 * total


def _constants_cost(
    constants: Sequence[FloatArray],
    block_count: int,
    noise: NoiseModel,
    white_power: FloatArray | None,
) -> float:
    """Return the squared norm of the whitened constants of all parts."""
    rate_hz = noise.sampling.rate_hz
    frequency_hz = dct_frequencies_hz(block_count, rate_hz)[: len(constants)]
    variance = noise.density_with(frequency_hz, white_power) * rate_hz / 2.0
    spectrum = orthonormal_dct(np.stack(constants, axis=-1))
    return float(np.sum(spectrum**2 / variance.T))
