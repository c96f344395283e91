"""Short pulses that the rig itself makes, told from glitches of the stream.

A step that the motor loses, or a base that gives way as the head starts and stops, is over
in a moment: in the residual it sticks out like a torn word. But it has gone through the
sensor's low-pass, turns about the axis that moves, and takes several samples in just the
ratio that the filter's response has; a glitch does so by chance only.

What to use when: `made_by_the_rig` for the rows that `spikes` would set aside.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray

BEFORE, AFTER = 2, 4  # rows beside those that stick out
LONGEST = 6  # rows in a row that stick out: more is no pulse
PHASES = 40  # moments to a sample at which a pulse may begin
EARLIEST = 4  # samples before the first that sticks out
LEFT_PER_VALUE = 2.5  # variances: more left is no pulse
LEFT_SHARE = 0.005  # and of the energy, for moments between those that are tried
CLEARLY = 10.0  # variances by which it must fit better than one spoilt word
_STILL_RAD = 1e-9  # in a sample


@dataclass(frozen=True, slots=True, eq=False)
class AxisMotion:
    """One axis at the instants of n samples, the sensor's lag taken out."""

    direction: FloatArray  # (n, 3), what its turn shows in the sensor, per rad/s
    moves: BoolArray  # (n,)
    turns_over: BoolArray  # (n,), where it starts or stops


def axis_motions(angle_rad: FloatArray, gain: FloatArray) -> tuple[AxisMotion, AxisMotion]:
    """Return how pan and tilt move at instants with these angles, (2, n), seen through G."""
    tilt = angle_rad[1]
    none, one = np.zeros_like(tilt), np.ones_like(tilt)
    stage = (np.stack([none, np.sin(tilt), np.cos(tilt)]), np.stack([one, none, none]))
    found = []
    for angle, turn in zip(angle_rad, stage, strict=True):
        turning = np.abs(np.diff(angle)) > _STILL_RAD
        edge = np.convolve(np.diff(turning, prepend=False, append=False), np.ones(5), "same") > 0.0
        moves = np.append(turning, False) | np.append(False, turning)
        found.append(AxisMotion(np.asarray((gain @ turn).T), moves | edge, edge))
    return found[0], found[1]


def made_by_the_rig(
    left: FloatArray,
    odd: BoolArray,
    time_s: FloatArray,
    axes: tuple[AxisMotion, ...],
    bandwidth_hz: float,
    deviation: FloatArray,
) -> BoolArray:
    """Return which of the rows that stick out a pulse of an axis explains, (n,).

    Args:
        left: residual of every sample, shape (n, 3).
        odd: rows that stick out, shape (n,).
        time_s: when samples were taken, the lag behind the motion taken out, shape (n,).
        axes: pan and tilt.
        bandwidth_hz: of the low-pass.
        deviation: of the noise, shape (3,).
    """
    found = np.zeros_like(odd)
    rows = np.flatnonzero(odd)
    if not rows.size:
        return found
    for group in np.split(rows, np.flatnonzero(np.diff(rows) > BEFORE) + 1):
        if group[-1] - group[0] >= LONGEST:
            continue
        near = np.arange(max(0, group[0] - BEFORE), min(odd.size, group[-1] + AFTER + 1))
        if any(
            _explains(left[near] / deviation, near, time_s, axis, bandwidth_hz, deviation, group)
            for axis in axes
        ):
            found[group] = True
    return found


def _explains(
    white: FloatArray,
    near: IntArray,
    time_s: FloatArray,
    axis: AxisMotion,
    bandwidth_hz: float,
    deviation: FloatArray,
    group: IntArray,
) -> bool:
    first = max(0, int(group[0]) - EARLIEST)
    if not axis.moves[first : group[-1] + 1].any():
        return False
    twice = bool(axis.turns_over[first : group[-1] + 1].any())
    energy = float(np.sum(white**2))
    begins = np.interp(
        np.arange(first * PHASES, (int(group[-1]) + 1) * PHASES) / PHASES,
        np.arange(first, group[-1] + 2),
        np.interp(np.arange(first, group[-1] + 2), np.arange(time_s.size), time_s),
    )
    along = axis.direction[near] / deviation
    least = energy
    for begin_s in begins:
        pulse, double = _response(time_s[near] - begin_s, bandwidth_hz)
        shapes = [pulse, double] if twice else [pulse]
        design = np.stack([(shape[:, None] * along).ravel() for shape in shapes], axis=1)
        best = np.linalg.lstsq(design, white.ravel(), rcond=1e-9)[0]
        least = min(least, float(np.sum((white.ravel() - design @ best) ** 2)))
    one_word = energy - float(np.max(white**2))
    enough = LEFT_PER_VALUE * white.size + LEFT_SHARE * energy
    return least < enough and one_word - least > CLEARLY


def _response(since_s: FloatArray, bandwidth_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return a second-order Butterworth's answer to a pulse, and to a double pulse, scaled."""
    x = np.maximum(since_s, 0.0) * (np.sqrt(2.0) * np.pi * bandwidth_hz)
    after = np.where(since_s > 0.0, np.exp(-x), 0.0)
    return after * np.sin(x), after * (np.cos(x) - np.sin(x))
