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

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.arrow import Arrow
from gyrorig_solver.reference.chain import Chain
from gyrorig_solver.reference.evidence import (
    COUNT_UNKNOWNS,
    STEP_VARIANCE,
    AxisCounts,
    CountUnknowns,
    Evidence,
)
from gyrorig_solver.reference.guess import first_guess
from gyrorig_solver.reference.moves import Motion, Move, started
from gyrorig_solver.reference.rests import likeliest_variance, with_detents
from gyrorig_solver.reference.table import MoveTable, Unknowns
from gyrorig_solver.reference.track import Track, lay_tracks

LOG_SPEED_STD = 1e-2
LOG_ACCELERATION_STD = 1e-2
AS_TOLD = 1e-6  # of a logarithm: none at all
COUNT_STD_STEPS = 0.5  # of the count's lag and of its offset, prior
LATE_SHARE_STD = 0.3  # of phi, prior, about one half
SEEN_START_STD_S = 1.0  # of a start that counts show: no more than a brace
UNSEEN_START_STD_S = 0.02  # of one that they may not show, about the delay of the others
ABOUT_S = 0.2  # the first guess is nearer than this
ROUNDS = 8
NEAR_S = 5e-3  # a step that is no longer leaves the starts near enough to judge the rests by
LATEST_JUDGING = 3  # round from which they are near enough in any case
JUDGINGS = 2
SETTLED_S = 5e-7  # starts that move by less, a hundredth of what is known of them, are in place


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
        ordered, middle = np.sort(counts), counts.size // 2
        return round(float(ordered[(counts.size - 1) // 2] + ordered[middle]) / 2.0)


@dataclass(frozen=True, eq=False)
class StartTimes:
    """The moves as the polls saw them, and how well."""

    table: MoveTable
    found: Unknowns
    # Over starts, rests as the stage has them, rests as counted; shared: log speeds, log
    # accelerations, the count's offset, its lag, and phi.
    information: Arrow
    common_std_s: float  # one shift of all starts together that polls cannot show
    instant_std_s: float  # scatter of the sample instant inside its window
    late_share: float  # phi
    rest_variance: float  # of a counted rest about its count, steps^2
    explained: bool  # False: the counts do not follow the moves that were told
    polls: Polls | None = None  # what it was fitted to

    @cached_property
    def moves(self) -> tuple[Move, ...]:
        """The moves with fitted starts."""
        return started(self.table.moves, self.found.starts_s)


@dataclass(frozen=True, slots=True, eq=False)
class _Layout:
    """Which unknown is where: starts, rests, log speeds, log accelerations, count, phi."""

    starts: slice
    rests: slice
    speeds: slice
    ramps: slice

    @classmethod
    def of(cls, table: MoveTable) -> "_Layout":
        rest = table.starts
        speed = rest + table.rests
        ramp = speed + table.classes
        return cls(slice(0, rest), slice(rest, speed), slice(speed, ramp), slice(ramp, ramp + 2))

    @property
    def size(self) -> int:
        return int(self.ramps.stop) + COUNT_UNKNOWNS

    def unknowns(self, at: FloatArray) -> Unknowns:
        return Unknowns(at[self.starts], at[self.rests], at[self.speeds], at[self.ramps])


def fit_starts(motion: Motion, polls: Polls) -> StartTimes:
    """Fit starts, rests, speeds and accelerations to the polled counts.

    Gauss-Newton in counts; each poll weighs by the count's quantum and the instant's
    scatter at the speed of that moment, the scatter being estimated from the residuals.
    """
    fit = _settled(_Fit(MoveTable.of(motion), polls))
    return replace(fit.result(), polls=polls)


def base_speed_instead(
    motion: Motion, starts: StartTimes, axis: int, added_steps_s: FloatArray
) -> FloatArray:
    """Return by how many nats higher base speeds are likelier than ramps of their own, (k,).

    Args:
        motion: as it was told.
        starts: found for it.
        axis: whose ramps are taken as told, and its base speed as higher.
        added_steps_s: by how much higher, (k,).
    """
    if starts.polls is None:
        return np.zeros(added_steps_s.size)
    own = _settled(_Fit(MoveTable.of(motion), starts.polls, None, starts.rest_variance))
    found = np.empty(added_steps_s.size)
    for k, added in enumerate(added_steps_s):
        moves = tuple(
            replace(one, base_speed_steps_s=one.base_speed_steps_s + float(added))
            if one.axis == axis
            else one
            for one in motion.moves
        )
        table = MoveTable.of(replace(motion, moves=moves))
        other = _settled(_Fit(table, starts.polls, axis, starts.rest_variance))
        found[k] = other.log_likelihood() - own.log_likelihood()
    return found


def _settled(fit: "_Fit") -> "_Fit":
    for turn in range(ROUNDS):
        fit.round(turn >= LATEST_JUDGING)
        if fit.settled:
            break
    return fit


class _Fit:
    """The fit under way."""

    def __init__(
        self,
        table: MoveTable,
        polls: Polls,
        as_told: int | None = None,
        rest_variance: float | None = None,
    ) -> None:
        """Begin at the first guess.

        Args:
            table: of the moves.
            polls: of both axes.
            as_told: the axis whose ramps are held at what was told.
            rest_variance: of rests about their counts; None: the likeliest.
        """
        self._table, self._layout = table, _Layout.of(table)
        self._counts, least_s = _counts(polls)
        self._delays = _Delays(table, first_guess(table, self._counts))
        self._weight = _prior(self._layout, self._delays.seen)
        if as_told is not None:
            self._weight[self._layout.ramps.start + as_told] = AS_TOLD**-2
        self._centre = np.zeros(self._layout.size)
        self._centre[self._layout.starts] = self._delays.guess_s
        self._centre[-1] = 0.5
        self._at = self._centre.copy()
        tracks = lay_tracks(table, self._layout.unknowns(self._at))
        pan, tilt = (_near(c, track) for c, track in zip(self._counts, tracks, strict=True))
        self._counts = (pan, tilt)
        self._scatter_s = max(least_s / float(np.sqrt(12.0)), 1e-6)
        self._common_s = (least_s + polls.constant_width_s) / float(np.sqrt(12.0))
        self._spacing_s: FloatArray | None = None
        self._rest_variance, self._judged, self._moved_s = STEP_VARIANCE, 0, np.inf
        if rest_variance is not None:
            self._rest_variance, self._judged = rest_variance, JUDGINGS

    @property
    def settled(self) -> bool:
        """True when another round would change nothing that matters."""
        return self._judged == JUDGINGS and self._moved_s < SETTLED_S

    def round(self, late: bool) -> None:
        """Take one step; judge the rests where the starts are near enough, or when it is late."""
        layout, at = self._layout, self._at
        self._chain = self._look()
        self._centre[layout.starts] = self._delays.expected_s(at[layout.starts])
        self._chain.hold(self._weight, self._centre - at)
        if self._judged < JUDGINGS and (self._moved_s < NEAR_S or late):
            self._rest_variance = likeliest_variance(self._chain, layout.rests, at[layout.rests])
            self._judged += 1
        held = np.zeros(layout.size)
        held[layout.rests] = 1.0 / self._rest_variance
        self._chain.hold(held, -at)
        step = self._chain.solve()
        self._at = at + step
        # Of all together: one poll that is now in and now out of the sum must not hold all.
        moved = step[layout.starts]
        self._moved_s = float(np.sqrt(np.mean(moved**2))) if moved.size else 0.0

    def result(self) -> StartTimes:
        """Return where the last round ended, and what it knew."""
        return StartTimes(
            table=self._table,
            found=self._layout.unknowns(self._at),
            information=with_detents(self._chain, self._table.starts),
            common_std_s=self._common_s,
            instant_std_s=self._scatter_s,
            late_share=float(self._at[-1]),
            rest_variance=self._rest_variance,
            explained=self._explained,
        )

    def log_likelihood(self) -> float:
        """Return the log likelihood of polls and rests where the last round ended."""
        if self._spacing_s is None:
            return 0.0
        polls = self._evidence().log_likelihood(self._scatter_s, self._spacing_s)
        rests = self._at[self._layout.rests]
        return polls - 0.5 * float(np.sum(rests**2)) / self._rest_variance

    def _evidence(self) -> Evidence:
        found, how = self._layout.unknowns(self._at), CountUnknowns(*self._at[-COUNT_UNKNOWNS:])
        return Evidence.of(self._table, self._counts, found, how)

    def _look(self) -> Chain:
        """Return the polls' equations at the unknowns of now; they are many, and let go."""
        evidence = self._evidence()
        if self._spacing_s is None:
            self._spacing_s = evidence.spacing_s()
        self._scatter_s = evidence.scatter_s(self._scatter_s)
        self._explained = evidence.explained(self._scatter_s)
        return evidence.equations(self._scatter_s, self._spacing_s)


def _counts(polls: Polls) -> tuple[tuple[AxisCounts, AxisCounts], float]:
    """Return each axis' own counts, and the least width of an exchange."""
    width = polls.hi_s - polls.lo_s
    least_s = float(np.percentile(width, 1.0)) if width.size else 0.0
    base_s, extra_s = polls.lo_s + least_s / 2.0, np.clip(width - least_s, 0.0, None)
    pan, tilt = (AxisCounts(base_s, extra_s, polls.steps[:, axis]) for axis in (0, 1))
    if polls.valid.all():
        return (pan, tilt), least_s
    return (pan.some(polls.valid[:, 0]), tilt.some(polls.valid[:, 1])), least_s


def _near(counts: AxisCounts, track: Track) -> AxisCounts:
    """Return the counts that may have been taken on the way: about half are not."""
    if track.begin_s.size == 0:
        return counts.some(slice(0, 0))
    at_s = counts.base_s + 0.5 * counts.extra_s
    move = np.searchsorted(track.begin_s - ABOUT_S, at_s, side="right") - 1
    return counts.some((move >= 0) & (at_s <= track.end_s[move] + ABOUT_S))


class _Delays:
    """How late orders take hold: alike, as far as counts do not show each for itself.

    The first order of a move shows in its counts. A change on the way may not, and no more
    a move that was not polled on its way (awaited, or too short).
    """

    def __init__(self, table: MoveTable, late_s: FloatArray) -> None:
        """Begin with how late each move seems to be, nan where its counts do not show it."""
        self._told_s = table.told_s
        late = np.repeat(late_s, np.diff(table.first))
        self.seen = np.zeros(late.size, dtype=np.bool_)
        self.seen[table.first[:-1]] = True
        self.seen &= np.isfinite(late)
        usual_s = float(np.median(late[self.seen])) if self.seen.any() else 0.0
        self.guess_s = self._told_s + np.where(np.isfinite(late), late, usual_s)

    def expected_s(self, starts_s: FloatArray) -> FloatArray:
        """Return where each start is expected: as it is, or as late as those that are seen."""
        if not self.seen.any():
            return self.guess_s
        usual_s = float(np.median((starts_s - self._told_s)[self.seen]))
        return np.where(self.seen, self.guess_s, self._told_s + usual_s)


def _prior(layout: _Layout, seen: BoolArray) -> FloatArray:
    """Return one over the prior variance of every unknown, rests apart."""
    weight = np.zeros(layout.size)
    weight[layout.starts] = np.where(seen, SEEN_START_STD_S**-2, UNSEEN_START_STD_S**-2)
    weight[layout.speeds] = LOG_SPEED_STD**-2
    weight[layout.ramps] = LOG_ACCELERATION_STD**-2
    weight[-COUNT_UNKNOWNS:] = [COUNT_STD_STEPS**-2, COUNT_STD_STEPS**-2, LATE_SHARE_STD**-2]
    return weight
