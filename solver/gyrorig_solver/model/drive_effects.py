"""Effects of the drive train on angles and motion profiles.

What to use when: `apply_play` for a gap in a gear; `moving_average` for a smoothed path;
`resonance_deflection` for a spring between motor and stage; `second_derivative` for the
acceleration of an angle; `replan_with_limits` for a move that the unit executed with other limits.
"""

from dataclasses import replace

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.model.recursive_filters import filter_from_rest, step_invariant
from gyrorig_solver.reference import MotionLimits, MotionProfile, plan_motion

_MIN_ANGLE_STEP_RAD = 1e-12  # smaller steps are rounding of an angle at rest
_MIN_WIDTH_S = 1e-5  # the difference of integrals over less is rounding
_STRAIGHT_SHARE = 1e-9  # of the fastest rate; a smaller change of the rate is rounding


def apply_play(angle_rad: FloatArray, gap_rad: float, start_face: float) -> FloatArray:
    """Return the output of a gear with backlash (play operator).

    Args:
        angle_rad: the input, shape (n + 1,).
        gap_rad: angle that the input turns back before the output follows.
        start_face: the initial contact: 1 pushes up, -1 down, 0 is in the middle.
    """
    half = gap_rad / 2.0
    output = np.empty_like(angle_rad)
    step = np.diff(angle_rad)
    turning = np.flatnonzero(np.abs(step) > _MIN_ANGLE_STEP_RAD)
    signs = np.sign(step[turning])
    ends = [*(turning[1:][np.diff(signs) != 0.0]).tolist(), angle_rad.size - 1]
    first, level = 0, float(angle_rad[0]) - start_face * half
    output[0] = level
    for end in ends:
        inside = angle_rad[first : end + 1]
        # The input is monotonic here, so the nearer face determines the output.
        output[first : end + 1] = np.clip(level, inside - half, inside + half)
        first, level = end, float(output[end])
    return output


def moving_average(edges_s: FloatArray, angle_rad: FloatArray, width_s: float) -> FloatArray:
    """Return the mean of the angle over `width_s` about each edge, by cubic interpolation.

    Straight lines between edges h apart would add h^2/12 angle'' to width^2/24 angle''. The angle
    is constant beyond the ends. At a constant rate, the mean is the angle, and is not computed.
    """
    if width_s <= _MIN_WIDTH_S:
        return angle_rad
    width, half = np.diff(edges_s), width_s / 2.0
    rise = np.diff(angle_rad) / width
    bent = _edges_near_bends(edges_s, rise, half)
    slope = np.zeros_like(angle_rad)
    slope[1:-1] = (rise[:-1] * width[1:] + rise[1:] * width[:-1]) / (width[:-1] + width[1:])
    square = (3.0 * rise - 2.0 * slope[:-1] - slope[1:]) / width
    cube = (slope[:-1] + slope[1:] - 2.0 * rise) / width**2

    def integral_within(k: IntArray, u: FloatArray) -> FloatArray:
        bent = slope[k] / 2.0 + u * (square[k] / 3.0 + u * cube[k] / 4.0)
        return np.asarray(u * (angle_rad[k] + u * bent), dtype=np.float64)

    every = np.arange(width.size)
    cumulative = np.concatenate([[0.0], np.cumsum(integral_within(every, width))])

    def integral(at_s: FloatArray) -> FloatArray:
        inside = np.clip(at_s, edges_s[0], edges_s[-1])
        k = np.clip(np.searchsorted(edges_s, inside, side="right") - 1, 0, width.size - 1)
        beyond = (at_s - inside) * np.where(at_s > inside, angle_rad[-1], angle_rad[0])
        return np.asarray(
            cumulative[k] + integral_within(k, inside - edges_s[k]) + beyond, np.float64
        )

    mean = angle_rad.copy()
    mean[bent] = (integral(edges_s[bent] + half) - integral(edges_s[bent] - half)) / width_s
    return mean


def _edges_near_bends(edges_s: FloatArray, rise_rad_s: FloatArray, half_s: float) -> BoolArray:
    """Return the edges within half a width of a change of the rate or of an end, shape (n + 1,)."""
    least = _STRAIGHT_SHARE * float(np.abs(rise_rad_s).max())
    changes = 1 + np.flatnonzero(np.abs(np.diff(rise_rad_s)) > least)
    bends = np.concatenate([[0], changes, [edges_s.size - 1]])
    before, after = np.maximum(bends - 1, 0), np.minimum(bends + 1, edges_s.size - 1)
    counts = np.zeros(edges_s.size + 1)
    np.add.at(counts, np.searchsorted(edges_s, edges_s[before] - half_s), 1.0)
    np.add.at(counts, np.searchsorted(edges_s, edges_s[after] + half_s, side="right"), -1.0)
    return np.asarray(np.cumsum(counts)[:-1] > 0.0, dtype=np.bool_)


def second_derivative(edges_s: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Return the angles' second derivative at the edges, (..., n + 1), zero at the ends."""
    rate = np.diff(angle_rad) / np.diff(edges_s)
    result = np.zeros_like(angle_rad)
    result[..., 1:-1] = np.diff(rate) / ((edges_s[2:] - edges_s[:-2]) / 2.0)
    return result


def resonance_deflection(
    edges_s: FloatArray, acceleration_rad_s2: FloatArray, frequency_hz: float, damping: float
) -> FloatArray:
    """Return the deflection q of q'' + 2 z w q' + w^2 q = -acceleration, (..., n + 1).

    The acceleration is constant between edges; a discrete system with the same poles is exact for
    that (zero-order hold).
    """
    w = 2.0 * np.pi * frequency_hz
    step_s = float(edges_s[-1] - edges_s[0]) / (edges_s.size - 1)
    numerator, denominator = step_invariant(w, damping, step_s)
    # The acceleration is constant from half a step before to half a step after its edge.
    interval_means = np.zeros_like(acceleration_rad_s2)
    np.add(
        acceleration_rad_s2[..., :-1], acceleration_rad_s2[..., 1:], out=interval_means[..., :-1]
    )
    return filter_from_rest(-0.5 * numerator, denominator, interval_means)


def replan_with_limits(
    profile: MotionProfile, acceleration_share: float, base_steps_s: float
) -> MotionProfile | None:
    """Return a motion with other acceleration and base speed; None if it has no ramps.

    Args:
        profile: of a move from rest to rest.
        acceleration_share: added to 1.
        base_steps_s: added to the base speed.
    """
    commands = profile.commands
    if all(
        command.limits.speed_steps_s <= command.limits.base_speed_steps_s for command in commands
    ):
        return None
    changed = [
        replace(
            command,
            limits=MotionLimits(
                speed_steps_s=command.limits.speed_steps_s,
                acceleration_steps_s2=command.limits.acceleration_steps_s2
                * (1.0 + acceleration_share),
                base_speed_steps_s=max(0.0, command.limits.base_speed_steps_s + base_steps_s),
            ),
        )
        for command in commands
    ]
    return plan_motion(float(profile.start_steps[0]), changed)
