"""What the causes on the unit's side need of angles and profiles over time.

What to use when: `play` for a gap in a gear; `box_mean` for a path made smooth; `resonance`
for a spring between motor and stage; `acceleration` for what bends a base; `relaid` for a
move carried out with other limits than it was told.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.model.recursive import recursed, step_invariant
from gyrorig_solver.reference.course import Course, Instruction, Limits, lay

_STILL_RAD = 1e-12  # rounding of an angle at rest
_NO_WIDTH_S = 1e-5  # a difference of integrals over less is their rounding


def play(angle_rad: FloatArray, gap_rad: float, begin: float) -> FloatArray:
    """Return the output of a gear with a gap: it follows once the gap is crossed.

    Args:
        angle_rad: the input, shape (n + 1,).
        gap_rad: how far the input turns before the output follows back.
        begin: where in the gap it begins: 1 pushes up, -1 down, 0 in the middle.
    """
    half = gap_rad / 2.0
    out = np.empty_like(angle_rad)
    step = np.diff(angle_rad)
    turning = np.flatnonzero(np.abs(step) > _STILL_RAD)
    signs = np.sign(step[turning])
    ends = [*(turning[1:][np.diff(signs) != 0.0]).tolist(), angle_rad.size - 1]
    at, level = 0, float(angle_rad[0]) - begin * half
    out[0] = level
    for end in ends:
        inside = angle_rad[at : end + 1]
        # The input is monotonous here, so the output is where the nearer face pushes it.
        out[at : end + 1] = np.clip(level, inside - half, inside + half)
        at, level = end, float(out[end])
    return out


def box_mean(edges_s: FloatArray, angle_rad: FloatArray, width_s: float) -> FloatArray:
    """Return the angle's mean over `width_s` about each edge, cubic between edges.

    Straight lines between edges h apart would add h^2/12 angle'' to width^2/24 angle''.
    Beyond the ends the angle stays what it is there.
    """
    if width_s <= _NO_WIDTH_S:
        return angle_rad
    width = np.diff(edges_s)
    rise = np.diff(angle_rad) / width
    slope = np.zeros_like(angle_rad)
    slope[1:-1] = (rise[:-1] * width[1:] + rise[1:] * width[:-1]) / (width[:-1] + width[1:])
    square = (3.0 * rise - 2.0 * slope[:-1] - slope[1:]) / width
    cube = (slope[:-1] + slope[1:] - 2.0 * rise) / width**2

    def inner(k: IntArray, u: FloatArray) -> FloatArray:
        bent = slope[k] / 2.0 + u * (square[k] / 3.0 + u * cube[k] / 4.0)
        return np.asarray(u * (angle_rad[k] + u * bent), dtype=np.float64)

    every = np.arange(width.size)
    whole = np.concatenate([[0.0], np.cumsum(inner(every, width))])

    def integral(at_s: FloatArray) -> FloatArray:
        inside = np.clip(at_s, edges_s[0], edges_s[-1])
        k = np.clip(np.searchsorted(edges_s, inside, side="right") - 1, 0, width.size - 1)
        beyond = (at_s - inside) * np.where(at_s > inside, angle_rad[-1], angle_rad[0])
        return np.asarray(whole[k] + inner(k, inside - edges_s[k]) + beyond, np.float64)

    half = width_s / 2.0
    return np.asarray((integral(edges_s + half) - integral(edges_s - half)) / width_s, np.float64)


def acceleration(edges_s: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Return the angle's second derivative at the edges, (n + 1,), zero at the ends."""
    rate = np.diff(angle_rad) / np.diff(edges_s)
    found = np.zeros_like(angle_rad)
    found[1:-1] = np.diff(rate) / ((edges_s[2:] - edges_s[:-2]) / 2.0)
    return found


def resonance(
    edges_s: FloatArray, angle_rad: FloatArray, frequency_hz: float, damping: float
) -> FloatArray:
    """Return the deflection q of q'' + 2 z w q' + w^2 q = -angle'', (n + 1,).

    The acceleration is held from edge to edge, which a discrete system of the same poles
    follows exactly (zero-order hold).
    """
    w = 2.0 * np.pi * frequency_hz
    step_s = float(edges_s[-1] - edges_s[0]) / (edges_s.size - 1)
    numerator, denominator = step_invariant(w, damping, step_s)
    push = -acceleration(edges_s, angle_rad)
    # Held from half a step before to half a step after the edge that it belongs to.
    early = np.append((push[:-1] + push[1:]) / 2.0, 0.0)
    return recursed(numerator, denominator, early)


def relaid(course: Course, acceleration_share: float, base_steps_s: float) -> Course | None:
    """Return a plain move with its acceleration and base speed changed, None for others.

    Args:
        course: from rest to rest; only one told target, without orders on the way.
        acceleration_share: added to 1.
        base_steps_s: added to the base speed.
    """
    told = course.limits
    if told is None or told.speed_steps_s <= told.base_speed_steps_s:
        return None
    limits = Limits(
        speed_steps_s=told.speed_steps_s,
        acceleration_steps_s2=told.acceleration_steps_s2 * (1.0 + acceleration_share),
        base_speed_steps_s=max(0.0, told.base_speed_steps_s + base_steps_s),
    )
    begin, target = float(course.start_s[0]), float(course.steps[-1])
    return lay(float(course.steps[0]), [Instruction(begin, "to", target, limits)])
