"""Impulses of the rig, separated from glitches of the stream by the filter's impulse response.

A step that the motor loses, or a base that twists when the head starts and stops, lasts only
milliseconds. In the residual it looks like a corrupt word. But it has passed through the sensor's
low-pass, turns about the moving axis, and affects several samples in the exact ratio of the
filter's response. A glitch does so only by chance.

What to use when: `impulse_response_mask` for the rows that `find_outliers` would exclude.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray, IntArray

ROWS_BEFORE, ROWS_AFTER = 2, 4  # rows before and after the outliers
MAX_GROUP_ROWS = 6  # consecutive outliers; a longer group is not an impulse
PHASES_PER_SAMPLE = 40  # start times per sample
EARLIEST_SAMPLES = 4  # samples before the first outlier
MAX_RESIDUAL_PER_VALUE = 2.5  # variances; an impulse has a smaller residual
# Share of the energy that an impulse may leave as residual: a low-pass with a bandwidth error of a
# tenth leaves 0.01, and sample times with a jitter of 0.9 ms leave 0.02 at 25 Hz.
MAX_RESIDUAL_SHARE = 0.03
MIN_IMPROVEMENT = 10.0  # variances: improvement over one corrupt word
MIN_INDEPENDENT_SHARE = 1e-9  # of a response that another one does not contain
_MIN_ANGLE_STEP_RAD = 1e-9  # per sample


@dataclass(frozen=True, slots=True, eq=False)
class AxisMotion:
    """One axis at the instants of n samples, corrected for the sensor's lag."""

    direction: FloatArray  # (n, 3), sensor rate per rad/s about the axis
    moving: BoolArray  # (n,)
    starts_or_stops: BoolArray  # (n,)


def axis_motions(angle_rad: FloatArray, gain: FloatArray) -> tuple[AxisMotion, AxisMotion]:
    """Return the motions of pan and tilt from their angles, (2, n), measured through G."""
    tilt = angle_rad[1]
    zeros, ones = np.zeros_like(tilt), np.ones_like(tilt)
    axis_directions = (
        np.stack([zeros, np.sin(tilt), np.cos(tilt)]),
        np.stack([ones, zeros, zeros]),
    )
    motions = []
    for angle, direction in zip(angle_rad, axis_directions, strict=True):
        turning = np.abs(np.diff(angle)) > _MIN_ANGLE_STEP_RAD
        edge = np.convolve(np.diff(turning, prepend=False, append=False), np.ones(5), "same") > 0.0
        moving = np.append(turning, False) | np.append(False, turning)
        motions.append(AxisMotion(np.asarray((gain @ direction).T), moving | edge, edge))
    return motions[0], motions[1]


def impulse_response_mask(
    residual: FloatArray,
    outlier: BoolArray,
    time_s: FloatArray,
    axes: tuple[AxisMotion, ...],
    bandwidth_hz: float,
    deviation: FloatArray,
) -> BoolArray:
    """Return which outliers an impulse about a moving axis explains, (n,).

    Args:
        residual: of every sample, shape (n, 3).
        outlier: rows with outliers, shape (n,).
        time_s: of the samples, corrected for the lag behind the motion, shape (n,).
        axes: pan and tilt.
        bandwidth_hz: of the low-pass.
        deviation: standard deviation of the noise, shape (3,).
    """
    mask = np.zeros_like(outlier)
    rows = np.flatnonzero(outlier)
    if not rows.size:
        return mask
    for group in np.split(rows, np.flatnonzero(np.diff(rows) > ROWS_BEFORE) + 1):
        if group[-1] - group[0] >= MAX_GROUP_ROWS:
            continue
        window = np.arange(
            max(0, group[0] - ROWS_BEFORE), min(outlier.size, group[-1] + ROWS_AFTER + 1)
        )
        if any(
            _is_impulse_response(
                residual[window] / deviation, window, time_s, axis, bandwidth_hz, deviation, group
            )
            for axis in axes
        ):
            mask[group] = True
    return mask


def _is_impulse_response(
    white: FloatArray,
    window: IntArray,
    time_s: FloatArray,
    axis: AxisMotion,
    bandwidth_hz: float,
    deviation: FloatArray,
    group: IntArray,
) -> bool:
    first = max(0, int(group[0]) - EARLIEST_SAMPLES)
    if not axis.moving[first : group[-1] + 1].any():
        return False
    has_double_pulse = bool(axis.starts_or_stops[first : group[-1] + 1].any())
    energy = float(np.sum(white**2))
    start_times_s = np.interp(
        np.arange(first * PHASES_PER_SAMPLE, (int(group[-1]) + 1) * PHASES_PER_SAMPLE)
        / PHASES_PER_SAMPLE,
        np.arange(first, group[-1] + 2),
        time_s[np.minimum(np.arange(first, group[-1] + 2), time_s.size - 1)],
    )
    direction = axis.direction[window] / deviation
    responses = _butterworth_responses(time_s[window] - start_times_s[:, None], bandwidth_hz)
    explained = _explained_energy(
        responses if has_double_pulse else responses[:1],
        np.linalg.norm(direction, axis=1),
        np.sum(white * direction, axis=1),
    )
    min_residual = energy - float(np.max(explained))
    residual_without_largest = energy - float(np.max(white**2))
    limit = MAX_RESIDUAL_PER_VALUE * white.size + MAX_RESIDUAL_SHARE * energy
    return min_residual < limit and residual_without_largest - min_residual > MIN_IMPROVEMENT


def _butterworth_responses(
    elapsed_s: FloatArray, bandwidth_hz: float
) -> tuple[FloatArray, FloatArray]:
    """Return a second-order Butterworth's responses to a pulse and to a double pulse, scaled."""
    x = np.maximum(elapsed_s, 0.0) * (np.sqrt(2.0) * np.pi * bandwidth_hz)
    decay = np.where(elapsed_s > 0.0, np.exp(-x), 0.0)
    return decay * np.sin(x), decay * (np.cos(x) - np.sin(x))


def _explained_energy(
    responses: Sequence[FloatArray], gain: FloatArray, along: FloatArray
) -> FloatArray:
    """Return the energy that a least-squares fit of responses explains, (starts,).

    Args:
        responses: linearly dependent ones count once, shape (starts, n) each.
        gain: length of the direction of the motion in each row, shape (n,).
        along: product of the data and the direction in each row, shape (n,).
    """
    explained = np.zeros(len(responses[0]))
    data = np.divide(along, gain, where=gain > 0.0, out=np.zeros_like(gain))
    basis: list[FloatArray] = []
    for response in responses:
        column = response * gain
        size = np.linalg.norm(column, axis=1)
        for unit in basis:
            column = column - np.sum(column * unit, axis=1)[:, None] * unit
        rest = np.linalg.norm(column, axis=1)
        independent = rest > MIN_INDEPENDENT_SHARE * size
        unit = np.where(independent, 1.0 / np.where(independent, rest, 1.0), 0.0)[:, None] * column
        product = unit @ data
        explained += product**2
        basis.append(unit)
    return explained
