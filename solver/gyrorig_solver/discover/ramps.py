"""Ramps that are not as steep as told, read where a fit has them already.

The unit's answers follow its true ramps, so a reference that is timed by them holds each
axis' acceleration as an unknown: nothing is left of it in a residual. What is found is
compared with what the unit was told instead; the answers say how surely.

What to use when: `look_for_ramps` beside the last fit of a search.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.chance import chi2_tail, normal_limit
from gyrorig_solver.discover.result import Limit, NamedCause, Value
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.model.terms.acceleration_error import AccelerationError
from gyrorig_solver.model.terms.base_speed_jump import BaseSpeedJump
from gyrorig_solver.model.terms.wording import PAN_TILT
from gyrorig_solver.reference.polls import base_speed_instead
from gyrorig_solver.reference.ptu import PtuReference

RAMPS = AccelerationError.cause
SHOWN_SIGMA = 3.0  # an axis this many deviations off is where it acts
POWER = 0.8  # of what is called detectable
STATED = 0.95  # belief that the stated set holds the cause
JUMPS_RAD_S = np.geomspace(5e-4, 0.2, 14)  # up to four times a factory setting of 2.9 deg/s


@dataclass(frozen=True, slots=True, eq=False)
class LookedAt:
    """What is said of the ramps: a name, or how far off they may be unseen."""

    named: NamedCause | None
    absent: tuple[Limit, ...]


def look_for_ramps(solution: Solution, tests: int, alpha: float) -> LookedAt:
    """Return how much steeper than told the ramps are, as a cause or a limit.

    Args:
        solution: the last fit of a search; what changes the law of motion is in it.
        tests: how many share the false alarms.
        alpha: rate of false alarms of all of them.
    """
    term = AccelerationError()
    if any(one.term.cause == term.cause and one.free.size for one in solution.extensions):
        return LookedAt(None, ())
    weight, total = np.zeros(2), np.zeros(2)
    for session in solution.sessions:
        if isinstance(session.reference, PtuReference) and session.reference.starts.explained:
            value, std = session.reference.log_acceleration
            some = np.isfinite(std)
            weight[some] += std[some] ** -2.0
            total[some] += value[some] * std[some] ** -2.0
    seen = weight > 0.0
    if not seen.any():
        return LookedAt(None, ())
    mean = np.divide(total, weight, out=np.zeros(2), where=seen)
    deviation = np.divide(1.0, np.sqrt(weight), out=np.full(2, np.inf), where=seen)
    statistic = float(np.sum((mean[seen] / deviation[seen]) ** 2))
    p_value = min(1.0, chi2_tail(statistic, float(seen.sum())) * tests)
    own = term.parameters[0]
    if p_value >= alpha:
        least = normal_limit(alpha / tests / 2.0) + normal_limit(1.0 - POWER)
        return LookedAt(
            None,
            tuple(
                Limit(term.cause, place, least * float(std), own.unit, own.typical, "", 0.0)
                for place, std in zip(PAN_TILT, deviation, strict=True)
                if np.isfinite(std)
            ),
        )
    share = np.expm1(mean)
    off = np.abs(mean) > SHOWN_SIGMA * deviation
    off[int(np.argmax(np.abs(mean) / deviation))] = True
    values = [
        Value(f"{own.name}.{place}", float(size), float(std), own.unit, own.typical)
        for place, size, std in zip(PAN_TILT, share, deviation, strict=True)
    ]
    named = NamedCause(
        term=term,
        where=tuple(place for place, one in zip(PAN_TILT, off, strict=True) if one),
        extension=Extension(term, share, np.zeros(0, dtype=np.int64)),
        values=tuple(values),
        statistic=statistic,
        degrees_of_freedom=int(seen.sum()),
        p_value=p_value,
        posterior=1.0,
        one_of=(),
        rivals=(),
        changes=(),  # the base model has the ramps as they are
        gain=None,
    )
    return LookedAt(_beside_jumps(named, solution), ())


def _beside_jumps(named: NamedCause, solution: Solution) -> NamedCause:
    """Return the name, or that of a base speed nobody told of, whichever the counts bear out.

    Below the base speed a motor starts at once: read by the told law such a ramp seems
    steeper, and the counts say which it is.
    """
    term = BaseSpeedJump()
    if any(one.term.cause == term.cause for one in solution.extensions):
        return named
    jumps, stds, ahead = np.zeros(2), np.full(2, np.inf), 0.0
    for axis, place in enumerate(PAN_TILT):
        if place not in named.where:
            continue
        nats = np.zeros(JUMPS_RAD_S.size)
        for session in solution.sessions:
            reference = session.reference
            if isinstance(reference, PtuReference):
                steps_s = JUMPS_RAD_S / abs(reference.rad_per_step[axis])
                nats += base_speed_instead(reference.motion, reference.starts, axis, steps_s)
        jumps[axis], stds[axis], best = _peak(nats)
        ahead += best
    share = float(1.0 / (1.0 + np.exp(np.clip(-ahead, -700.0, 700.0))))
    if ahead <= 0.0:
        one_of = (term.cause,) if 1.0 - share < STATED else ()
        return replace(named, posterior=1.0 - share, one_of=one_of)
    own = term.parameters[0]
    return replace(
        named,
        term=term,
        extension=Extension(term, jumps, np.zeros(0, dtype=np.int64)),
        values=tuple(
            Value(f"{own.name}.{place}", float(size), float(std), own.unit, own.typical)
            for place, size, std in zip(PAN_TILT, jumps, stds, strict=True)
        ),
        posterior=share,
        one_of=(RAMPS,) if share < STATED else (),
    )


def _peak(nats: FloatArray) -> tuple[float, float, float]:
    """Return the likeliest jump, its deviation and its nats, by a parabola about the best."""
    best = int(np.clip(np.argmax(nats), 1, nats.size - 2))
    near = slice(best - 1, best + 2)
    bend, slope, _ = np.polyfit(JUMPS_RAD_S[near], nats[near], 2)
    if bend >= 0.0:
        return float(JUMPS_RAD_S[best]), np.inf, float(nats[best])
    at = float(np.clip(-slope / (2.0 * bend), JUMPS_RAD_S[best - 1], JUMPS_RAD_S[best + 1]))
    return at, float(np.sqrt(-0.5 / bend)), float(nats.max())
