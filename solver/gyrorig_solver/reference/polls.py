"""When each move started, from the counts that the controller answered.

A poll says: at some instant between the request's last byte and the reply's first, the
count was c. Neither the quantum of the count nor the instant is known better, and both
are put in as what they are: the count is uniform over one step, the instant is
lo + W_min/2 + phi (W - W_min), where W is the window's width, phi (fitted) the share of
any extra delay that lies before the sample, and the least width W_min leaves one
constant that no poll can show: uniform, standard deviation W_min/sqrt(12). It goes into
the time offset's uncertainty and into nothing else.

Whether a controller counts a step when it begins or when it is done is not known either:
the count may lag the motion, and may be cut instead of rounded, by up to half a step;
both are fitted. The lag cannot be told from late starts where all moves have one speed,
and the covariance of the starts says so.

Speed and acceleration are fitted too, each with a tight prior at what was told: a
controller's timer cannot make every speed (unit's notes, section 7: up to 0.1 %).
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.reference.moves import Motion, Move, started
from gyrorig_solver.reference.trapezoid import Trapezoid

LOG_SPEED_STD = 1e-2
LOG_ACCELERATION_STD = 1e-2
COUNT_STD_STEPS = 0.5  # of the count's lag and of its offset, prior
LATE_SHARE_STD = 0.3  # of phi, prior, about one half
STEP_VARIANCE = 1.0 / 12.0
_STEP = 1e-4  # relative step of the numerical derivative by speed and acceleration


@dataclass(frozen=True, slots=True, eq=False)
class Polls:
    """Answered counts of one recording; times in s on the capture clock."""

    lo_s: FloatArray  # (n,), earliest instant the sample can have been taken
    hi_s: FloatArray  # (n,), latest
    steps: FloatArray  # (n, 2), pan and tilt
    valid: BoolArray  # (n, 2), True where the exchange answered that axis
    constant_width_s: float = 0.0  # all instants together may be off by half of this


@dataclass(frozen=True, slots=True, eq=False)
class StartTimes:
    """Moves with fitted starts, and what is known of starts, speeds and accelerations."""

    moves: tuple[Move, ...]
    log_speed: FloatArray  # (classes,), found relative to told
    log_acceleration: FloatArray  # (2,)
    information: FloatArray  # (k + classes + 2,) squared: starts, log speeds, log accelerations
    common_std_s: float  # one shift of all starts together that polls cannot show
    instant_std_s: float  # scatter of the sample instant inside its window
    late_share: float  # phi
    explained: bool  # False: the counts do not follow the moves that were told


def altered(profile: Trapezoid, log_speed: float, log_acceleration: float) -> Trapezoid:
    """Return the profile at a speed and acceleration off by these factors' logarithms."""
    return Trapezoid(
        profile.distance_steps,
        profile.speed_steps_s * float(np.exp(log_speed)),
        profile.acceleration_steps_s2 * float(np.exp(log_acceleration)),
        profile.base_speed_steps_s,
    )


def fit_starts(motion: Motion, polls: Polls) -> StartTimes:
    """Fit start times, speeds and accelerations to the polled counts.

    Gauss-Newton in counts, five rounds; each poll weighs by the count's quantum and the
    instant's scatter at the speed of that moment, the scatter being estimated from the
    residuals. Only polls near a move take part: rests carry no time.
    """
    width = polls.hi_s - polls.lo_s
    least = float(np.percentile(width, 1.0)) if width.size else 0.0
    extra = np.clip(width - least, 0.0, None)
    base_s = polls.lo_s + least / 2.0
    shared = motion.classes + 2
    # Log speeds, log accelerations, count's offset, count's lag, phi.
    parameters = np.zeros(shared + 3)
    parameters[-1] = 0.5
    prior = np.concatenate(
        [
            np.full(motion.classes, LOG_SPEED_STD**-2),
            np.full(2, LOG_ACCELERATION_STD**-2),
            [COUNT_STD_STEPS**-2.0, COUNT_STD_STEPS**-2.0, LATE_SHARE_STD**-2.0],
        ]
    )
    centre = parameters.copy()
    moves = _first_guess(motion.moves, polls, base_s + 0.5 * extra)
    scatter_s = max(least / np.sqrt(12.0), 1e-6)
    for _ in range(6):
        system = _System(moves, polls, base_s, extra, parameters, motion.classes)
        scatter_s = system.scatter_s(scatter_s)
        information, score = system.normal(scatter_s, prior, prior * (centre - parameters))
        step = np.linalg.solve(information, score)
        count = len(moves)
        moves = started(moves, np.array([m.start_s for m in moves]) + step[:count])
        parameters = parameters + step[count:]
    count = len(moves)
    keep, drop = slice(0, count + shared), slice(count + shared, None)
    marginal = information[keep, keep] - information[keep, drop] @ np.linalg.solve(
        information[drop, drop], information[drop, keep]
    )
    return StartTimes(
        moves=moves,
        log_speed=parameters[: motion.classes],
        log_acceleration=parameters[motion.classes : shared],
        information=marginal,
        common_std_s=(least + polls.constant_width_s) / float(np.sqrt(12.0)),
        instant_std_s=scatter_s,
        late_share=float(parameters[-1]),
        explained=system.explained(scatter_s),
    )


def _first_guess(moves: tuple[Move, ...], polls: Polls, at_s: FloatArray) -> tuple[Move, ...]:
    """Start each move where the middle of its travel, as polled, says it did."""
    starts = []
    for move in moves:
        length = move.profile.duration_s
        near = (
            (at_s > move.told_s) & (at_s < move.told_s + length + 0.5) & polls.valid[:, move.axis]
        )
        gone = move.sign * (polls.steps[near, move.axis] - move.from_steps)
        way = gone / move.profile.distance_steps
        middle = (way > 0.1) & (way < 0.9)
        grid = np.linspace(0.0, length, 400)
        since = np.interp(gone[middle], move.profile.position_steps(grid), grid)
        starts.append(float(np.median(at_s[near][middle] - since)) if middle.any() else move.told_s)
    return started(moves, np.array(starts))


class _System:
    """The residuals of all polls near moves at one set of parameters, and their slopes."""

    def __init__(
        self,
        moves: tuple[Move, ...],
        polls: Polls,
        base_s: FloatArray,
        extra_s: FloatArray,
        parameters: FloatArray,
        classes: int,
    ) -> None:
        self._count, self._classes = len(moves), classes
        self._rows: list[tuple[int, int, int, FloatArray, FloatArray, FloatArray]] = []
        offset, lag, phi = parameters[-3:]
        at_s = base_s + phi * extra_s
        for k, move in enumerate(moves):
            first, last = np.searchsorted(at_s, [move.start_s - 0.01, move.end_s + 0.01])
            near = np.arange(first, last)
            near = near[polls.valid[near, move.axis]]
            since = at_s[near] - move.start_s
            told = (parameters[move.speed_class], parameters[classes + move.axis])
            profile = altered(move.profile, *told)
            speed = profile.speed_at_steps_s(since)
            gone = move.sign * (polls.steps[near, move.axis] - move.from_steps)
            active = speed > 0.0
            residual = gone - profile.position_steps(since)
            residual -= (move.sign * offset - lag) * active
            slopes = np.column_stack(
                [
                    -speed,
                    _slope(move.profile, told, since, 0),
                    _slope(move.profile, told, since, 1),
                    move.sign * active,
                    -1.0 * active,
                    speed * extra_s[near],
                ]
            )
            self._rows.append((k, move.speed_class, move.axis, residual, slopes, speed))

    def scatter_s(self, before_s: float) -> float:
        """Return the instant's scatter that the residuals show, robustly."""
        residual = np.concatenate([r[3] for r in self._rows] or [np.zeros(0)])
        speed = np.concatenate([r[5] for r in self._rows] or [np.zeros(0)])
        if residual.size < 10:
            return before_s
        near = np.abs(residual) < 5.0 * np.sqrt(STEP_VARIANCE + (speed * before_s) ** 2) + 1.0
        near &= speed > 0.0
        if near.sum() < 10:
            return before_s
        weight = speed[near] ** 2 / (STEP_VARIANCE + (speed[near] * before_s) ** 2) ** 2
        excess = float(np.sum(weight * (residual[near] ** 2 - STEP_VARIANCE)))
        found = excess / float(np.sum(weight * speed[near] ** 2))
        return float(np.sqrt(max(found, 1e-12)))

    def explained(self, scatter_s: float) -> bool:
        """True when nine in ten counts lie within five deviations of the told motion."""
        residual = np.concatenate([r[3] for r in self._rows] or [np.zeros(0)])
        speed = np.concatenate([r[5] for r in self._rows] or [np.zeros(0)])
        if not residual.size:
            return True
        limit = 5.0 * np.sqrt(STEP_VARIANCE + (speed * scatter_s) ** 2) + 1.0
        return bool(np.mean(np.abs(residual) < limit) > 0.9) and scatter_s < 0.05

    def normal(
        self, scatter_s: float, prior: FloatArray, pull: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the normal matrix and score of (starts, shared parameters)."""
        size = self._count + prior.size
        information, score = np.zeros((size, size)), np.zeros(size)
        shared = np.arange(self._count, size)
        information[shared, shared] = prior
        score[shared] = pull
        # A start that no poll saw stays where it was told, within a second.
        starts = np.arange(self._count)
        information[starts, starts] += 1.0
        for k, speed_class, axis, residual, slopes, speed in self._rows:
            sigma = np.sqrt(STEP_VARIANCE + (speed * scatter_s) ** 2)
            # Tukey-like limit: a count that cannot be (a garbled reply) has no vote.
            weight = np.where(np.abs(residual) < 6.0 * sigma + 1.0, sigma**-2, 0.0)
            index = np.array(
                [
                    k,
                    self._count + speed_class,
                    self._count + self._classes + axis,
                    size - 3,
                    size - 2,
                    size - 1,
                ]
            )
            information[np.ix_(index, index)] += slopes.T @ (weight[:, None] * slopes)
            score[index] += slopes.T @ (weight * residual)
        return information, score


def _slope(
    profile: Trapezoid, told: tuple[float, float], since_s: FloatArray, which: int
) -> FloatArray:
    """Return the position's derivative by log speed (0) or log acceleration (1)."""
    up, down = list(told), list(told)
    up[which] += _STEP
    down[which] -= _STEP
    higher = altered(profile, up[0], up[1]).position_steps(since_s)
    lower = altered(profile, down[0], down[1]).position_steps(since_s)
    return np.asarray((higher - lower) / (2.0 * _STEP), dtype=np.float64)
