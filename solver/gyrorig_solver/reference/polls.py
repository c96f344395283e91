"""When each order took hold and where each rest is, from the counts that were answered.

A poll says: at some instant between the request's last byte and the reply's first, the
count was c. Neither the quantum of the count nor the instant is known better, and both
are put in as what they are: the count is uniform over one step, the instant is
lo + W_min/2 + phi (W - W_min), where W is the window's width, phi (fitted) the share of
any extra delay that lies before the sample, and the least width W_min leaves one
constant that no poll can show: uniform, standard deviation W_min/sqrt(12). It goes into
the time offset's uncertainty and into nothing else. A controller's counter makes all
windows one (see `counter`).

Whether a controller counts a step when it begins or when it is done is not known either:
the count may lag the motion, and may be cut instead of rounded, by up to half a step;
both are fitted. The lag cannot be told from late starts where all moves have one speed,
and the covariance of the starts says so.

Speed and acceleration are fitted too, each with a tight prior at what was told: a
controller's timer cannot make every speed (unit's notes, section 7: up to 0.1 %).

A rest may lie anywhere within its count: a unit may round a target and count along. The
polls on the way show it, and how far rests lie off their counts in general is chosen by
the likelihood of all polls (see `rests`).
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.arrow import Arrow
from gyrorig_solver.reference.moves import Motion, Move, started
from gyrorig_solver.reference.rests import likeliest_variance, loosened_rests
from gyrorig_solver.reference.slopes import slopes

LOG_SPEED_STD = 1e-2
LOG_ACCELERATION_STD = 1e-2
COUNT_STD_STEPS = 0.5  # of the count's lag and of its offset, prior
LATE_SHARE_STD = 0.3  # of phi, prior, about one half
STEP_VARIANCE = 1.0 / 12.0
SEEN_START_STD_S = 1.0  # of a start that counts show: no more than a brace
UNSEEN_START_STD_S = 0.02  # of one that they may not show, about the delay of the others
EDGE_STEPS = 1.5  # counts this near to a rest are rounded one way and say little
ROUNDS = 8
JUDGING_ROUNDS = (3, 4)  # the starts are near enough by then to judge the rests by
SETTLED_S = 5e-6  # a start that moves by less, a tenth of what is known of it, is in place
_SEARCH_S = np.arange(0.0, 0.3, 0.005)  # how late orders may be


@dataclass(frozen=True, slots=True, eq=False)
class Polls:
    """Answered counts of one recording; times in s on the capture clock."""

    lo_s: FloatArray  # (n,), earliest instant the sample can have been taken
    hi_s: FloatArray  # (n,), latest
    steps: FloatArray  # (n, 2), pan and tilt
    valid: BoolArray  # (n, 2), True where the exchange answered that axis
    constant_width_s: float = 0.0  # all instants together may be off by half of this

    def resting(self, axis: int, after_s: float, before_s: float) -> int | None:
        """Return the count that an axis showed between two times, None where none was polled."""
        first, last = np.searchsorted(self.lo_s, [after_s, before_s], side="right")
        near = slice(int(first), int(last))
        inside = (self.hi_s[near] < before_s) & self.valid[near, axis]
        counts = self.steps[near, axis][inside]
        if counts.size < 2:
            return None
        return round(float(np.median(counts)))


@dataclass(frozen=True, slots=True, eq=False)
class StartTimes:
    """Moves with fitted starts, and what is known of starts, rests, speeds, accelerations."""

    moves: tuple[Move, ...]
    rest_steps: FloatArray  # (rests,), off the count
    log_speed: FloatArray  # (classes,), found relative to told
    log_acceleration: FloatArray  # (2,)
    information: Arrow  # starts, rests; shared: log speeds, log accelerations
    common_std_s: float  # one shift of all starts together that polls cannot show
    instant_std_s: float  # scatter of the sample instant inside its window
    late_share: float  # phi
    rest_variance: float  # of a rest about its count, steps^2
    explained: bool  # False: the counts do not follow the moves that were told


@dataclass(frozen=True, slots=True, eq=False)
class _Layout:
    """Which parameter is where: starts, rests, log speeds, log accelerations, count, phi."""

    first: tuple[int, ...]  # each move's first start
    starts: int
    rests: int
    classes: int

    @classmethod
    def of(cls, motion: Motion) -> "_Layout":
        counts = [len(move.orders) for move in motion.moves]
        first = tuple(int(n) for n in np.concatenate([[0], np.cumsum(counts)])[:-1])
        return cls(first, sum(counts), len(motion.rests), motion.classes)

    @property
    def rest(self) -> int:
        return self.starts

    @property
    def speed(self) -> int:
        return self.starts + self.rests

    @property
    def ramp(self) -> int:
        return self.speed + self.classes

    @property
    def kept(self) -> int:
        """All but the count's offset, its lag, and phi."""
        return self.ramp + 2

    @property
    def size(self) -> int:
        return self.kept + 3


def fit_starts(motion: Motion, polls: Polls) -> StartTimes:
    """Fit starts, rests, speeds and accelerations to the polled counts.

    Gauss-Newton in counts; each poll weighs by the count's quantum and the instant's
    scatter at the speed of that moment, the scatter being estimated from the residuals.
    Only polls of moving axes take part: at rest a count carries no time.
    """
    layout = _Layout.of(motion)
    width = polls.hi_s - polls.lo_s
    least = float(np.percentile(width, 1.0)) if width.size else 0.0
    extra = np.clip(width - least, 0.0, None)
    base_s = polls.lo_s + least / 2.0
    delays = _Delays(motion.moves, _first_guess(motion.moves, polls, base_s + 0.5 * extra))
    centre = np.zeros(layout.size)
    centre[: layout.starts] = delays.guess_s
    centre[-1] = 0.5
    parameters = centre.copy()
    weight = _prior(layout, delays.seen)
    scatter_s = max(least / np.sqrt(12.0), 1e-6)
    rest_variance = STEP_VARIANCE
    standing = slice(layout.rest, layout.speed)
    for turn in range(ROUNDS):
        system = _System(motion, layout, polls, base_s, extra, parameters)
        scatter_s = system.scatter_s(scatter_s)
        information, score = system.normal(scatter_s)
        information[np.arange(layout.size), np.arange(layout.size)] += weight
        centre[: layout.starts] = delays.expected_s(parameters[: layout.starts])
        score += weight * (centre - parameters)
        if turn in JUDGING_ROUNDS:
            rest_variance = likeliest_variance(information, score, standing, parameters[standing])
        at = np.arange(layout.rest, layout.speed)
        information[at, at] += 1.0 / rest_variance
        score[at] -= parameters[at] / rest_variance
        step = np.linalg.solve(information, score)
        parameters = parameters + step
        if turn > JUDGING_ROUNDS[-1] and np.abs(step[: layout.starts]).max(initial=0.0) < SETTLED_S:
            break
    keep, drop = slice(0, layout.kept), slice(layout.kept, None)
    marginal = information[keep, keep] - information[keep, drop] @ np.linalg.solve(
        information[drop, drop], information[drop, keep]
    )
    return StartTimes(
        moves=started(motion.moves, parameters[: layout.starts]),
        rest_steps=parameters[standing],
        log_speed=parameters[layout.speed : layout.ramp],
        log_acceleration=parameters[layout.ramp : layout.kept],
        information=Arrow.from_dense(loosened_rests(marginal, standing), layout.classes + 2),
        common_std_s=(least + polls.constant_width_s) / float(np.sqrt(12.0)),
        instant_std_s=scatter_s,
        late_share=float(parameters[-1]),
        rest_variance=rest_variance,
        explained=system.explained(scatter_s),
    )


class _Delays:
    """How late orders take hold: alike, as far as counts do not show each for itself.

    The first order of a move shows in its counts. A change on the way may not, and no more
    a move that was not polled on its way (awaited, or too short).
    """

    def __init__(self, moves: tuple[Move, ...], late_s: FloatArray) -> None:
        """Begin with how late each move seems to be, nan where its counts do not show it."""
        self._told_s = np.array([order.told_s for move in moves for order in move.orders])
        late = np.repeat(late_s, [len(move.orders) for move in moves])
        first = [k == 0 for move in moves for k in range(len(move.orders))]
        self.seen = np.array(first, dtype=np.bool_) & np.isfinite(late)
        usual_s = float(np.median(late[self.seen])) if self.seen.any() else 0.0
        self.guess_s = self._told_s + np.where(np.isfinite(late), late, usual_s)

    def expected_s(self, starts_s: FloatArray) -> FloatArray:
        """Return where each start is expected: as it is, or as late as those that are seen."""
        if not self.seen.any():
            return self.guess_s
        usual_s = float(np.median((starts_s - self._told_s)[self.seen]))
        return np.where(self.seen, self.guess_s, self._told_s + usual_s)


def _prior(layout: _Layout, seen: BoolArray) -> FloatArray:
    """Return one over the prior variance of every parameter, rests apart."""
    weight = np.zeros(layout.size)
    weight[: layout.starts] = np.where(seen, SEEN_START_STD_S**-2, UNSEEN_START_STD_S**-2)
    weight[layout.speed : layout.ramp] = LOG_SPEED_STD**-2
    weight[layout.ramp : layout.kept] = LOG_ACCELERATION_STD**-2
    weight[layout.kept :] = [COUNT_STD_STEPS**-2, COUNT_STD_STEPS**-2, LATE_SHARE_STD**-2]
    return weight


def _first_guess(moves: tuple[Move, ...], polls: Polls, at_s: FloatArray) -> FloatArray:
    """Return how late each move fits its counts best, nan where no poll saw it on its way."""
    late = np.full(len(moves), np.nan)
    still = np.zeros(1 + max((max(move.classes) for move in moves), default=0))
    for k, move in enumerate(moves):
        told_s = np.array([order.told_s for order in move.orders])
        course = move.course(told_s, still, 0.0)
        first, last = np.searchsorted(at_s, [move.told_s, course.end_s + float(_SEARCH_S[-1])])
        near = np.arange(first, last)
        counted = polls.steps[near, move.axis]
        on_way = (counted != move.from_steps) & (counted != move.to_steps)
        if not np.any(on_way & polls.valid[near, move.axis]):
            continue
        near, counted = near[polls.valid[near, move.axis]], counted[polls.valid[near, move.axis]]
        # The course shifts as a whole, so one course serves every delay tried.
        since = at_s[near][None, :] - _SEARCH_S[:, None]
        off = np.abs(counted - course.position_steps(since))
        late[k] = _SEARCH_S[int(np.argmin(np.sum(np.minimum(off, 50.0), axis=1)))]
    return late


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """The polls of one move."""

    index: IntArray  # of the parameters that matter
    residual: FloatArray
    slopes: FloatArray  # (polls, parameters)
    speed: FloatArray  # steps/s, not signed
    share: FloatArray  # of an independent count that each poll is worth


class _System:
    """The residuals of all polls near moves at one set of parameters, and their slopes."""

    def __init__(
        self,
        motion: Motion,
        layout: _Layout,
        polls: Polls,
        base_s: FloatArray,
        extra_s: FloatArray,
        parameters: FloatArray,
    ) -> None:
        self._size = layout.size
        self._rows: list[_Rows] = []
        self._layout, self._parameters = layout, parameters
        at_s = base_s + parameters[-1] * extra_s
        rests = motion.rests
        arrivals = {rest.arrival: k for k, rest in enumerate(rests)}
        departures = {rest.departure: k for k, rest in enumerate(rests)}
        for k, move in enumerate(motion.moves):
            ends = (departures[k], arrivals[k])
            rows = self._move(k, move, ends, polls, at_s, extra_s)
            if rows is not None:
                self._rows.append(rows)

    def _move(
        self,
        k: int,
        move: Move,
        rests: tuple[int, int],
        polls: Polls,
        at_s: FloatArray,
        extra_s: FloatArray,
    ) -> _Rows | None:
        layout, found = self._layout, self._parameters
        own = layout.first[k] + np.arange(len(move.orders))
        log_speed = found[layout.speed : layout.ramp]
        log_ramp = float(found[layout.ramp + move.axis])
        course = move.course(found[own], log_speed, log_ramp)
        first, last = np.searchsorted(at_s, [found[own[0]], course.end_s])
        near = np.arange(first, last)
        near = near[polls.valid[near, move.axis]]
        spacing_s = float(np.median(np.diff(at_s[near]))) if near.size > 2 else 0.0
        counted = polls.steps[near, move.axis]
        speed = course.speed_steps_s(at_s[near])
        position = course.position_steps(at_s[near])
        edge = np.minimum(np.abs(position - move.from_steps), np.abs(position - move.to_steps))
        use = (speed != 0.0) & (edge > EDGE_STEPS)
        if not use.any():
            return None
        near, counted, speed, position = near[use], counted[use], speed[use], position[use]
        at = at_s[near]
        share = course.share(at)
        sign = np.sign(speed)
        from_rest, to_rest = layout.rest + rests[0], layout.rest + rests[1]
        offset, lag = found[-3], found[-2]
        model = position + (1.0 - share) * found[from_rest] + share * found[to_rest]
        by = slopes(move, found[own], log_speed, log_ramp, at)
        index = [
            *own,
            from_rest,
            to_rest,
            *(layout.speed + c for c in move.classes),
            layout.ramp + move.axis,
            *range(layout.kept, layout.size),
        ]
        columns = [
            *by.starts,
            1.0 - share,
            share,
            *by.speeds,
            by.acceleration,
            np.ones_like(sign),
            -sign,
            speed * extra_s[near],
        ]
        return _Rows(
            index=np.array(index, dtype=np.int64),
            residual=counted - model - offset + sign * lag,
            slopes=np.column_stack(columns),
            speed=np.abs(speed),
            share=np.minimum(1.0, np.abs(speed) * spacing_s) if spacing_s else np.ones_like(speed),
        )

    def scatter_s(self, before_s: float) -> float:
        """Return the instant's scatter that the residuals show, robustly."""
        residual, speed = self._joined()
        near = np.abs(residual) < 5.0 * np.sqrt(STEP_VARIANCE + (speed * before_s) ** 2) + 1.0
        if near.sum() < 10:
            return before_s
        weight = speed[near] ** 2 / (STEP_VARIANCE + (speed[near] * before_s) ** 2) ** 2
        excess = float(np.sum(weight * (residual[near] ** 2 - STEP_VARIANCE)))
        found = excess / float(np.sum(weight * speed[near] ** 2))
        return float(np.sqrt(max(found, 1e-12)))

    def explained(self, scatter_s: float) -> bool:
        """True when nine in ten counts lie within five deviations of the told motion."""
        residual, speed = self._joined()
        if not residual.size:
            return True
        limit = 5.0 * np.sqrt(STEP_VARIANCE + (speed * scatter_s) ** 2) + 1.0
        return bool(np.mean(np.abs(residual) < limit) > 0.9) and scatter_s < 0.05

    def normal(self, scatter_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the normal matrix and score of all parameters, without any prior."""
        information, score = np.zeros((self._size, self._size)), np.zeros(self._size)
        for rows in self._rows:
            sigma = np.sqrt(STEP_VARIANCE + (rows.speed * scatter_s) ** 2)
            # A count that cannot be (a garbled reply) has no vote. Polls of one and the
            # same step repeat each other's rounding and share theirs.
            sound = np.abs(rows.residual) < 6.0 * sigma + 1.0
            weight = np.where(sound, rows.share * sigma**-2, 0.0)
            weighed = rows.slopes.T * weight
            information[np.ix_(rows.index, rows.index)] += weighed @ rows.slopes
            score[rows.index] += weighed @ rows.residual
        return information, score

    def _joined(self) -> tuple[FloatArray, FloatArray]:
        residual = np.concatenate([r.residual for r in self._rows] or [np.zeros(0)])
        return residual, np.concatenate([r.speed for r in self._rows] or [np.zeros(0)])
