"""What the polled counts say of a motion at given unknowns: residuals, slopes, equations.

Only polls of moving axes take part: at rest a count carries no time. All polls of one axis
are looked up at once; only moves with orders on the way are differentiated one by one.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.reference.chain import Chain
from gyrorig_solver.reference.slopes import slopes
from gyrorig_solver.reference.table import MoveTable, Unknowns
from gyrorig_solver.reference.track import Track, lay_tracks

STEP_VARIANCE = 1.0 / 12.0
EDGE_STEPS = 1.5  # counts this near to a rest are rounded one way and say little
COUNT_UNKNOWNS = 3  # the count's offset, its lag, and phi: the last shared ones
AT_ONCE = 1 << 16  # polls; more would only need more memory
FEWEST = 10  # residuals that show a scatter


@dataclass(frozen=True, slots=True, eq=False)
class AxisCounts:
    """The answered counts of one axis, in the order of time."""

    base_s: FloatArray  # (n,), the instant where no extra delay lies before it
    extra_s: FloatArray  # (n,), width of the exchange beyond the least
    steps: FloatArray  # (n,)

    def some(self, which: slice | BoolArray) -> "AxisCounts":
        """Return some of them."""
        return AxisCounts(self.base_s[which], self.extra_s[which], self.steps[which])


@dataclass(frozen=True, slots=True, eq=False)
class CountUnknowns:
    """How counts follow the motion."""

    offset_steps: float
    lag_steps: float
    late_share: float  # phi


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Some polls on the way of one axis, move by move."""

    move: IntArray  # (n,)
    at_s: FloatArray  # (n,)
    speed: FloatArray  # (n,), steps/s, not signed
    # Slopes by start, rest before, rest after, log speed, log acceleration, offset, lag and
    # phi, then the residual.
    rows: FloatArray  # (n, 9)

    def weight(self, scatter_s: float, spacing_s: FloatArray) -> FloatArray:
        """Return what each poll weighs, shape (n,)."""
        sigma = np.sqrt(STEP_VARIANCE + (self.speed * scatter_s) ** 2)
        # A count that cannot be (a garbled reply) has no vote. Polls of one and the same
        # step repeat each other's rounding and share theirs.
        sound = np.abs(self.rows[:, -1]) < 6.0 * sigma + 1.0
        spacing = spacing_s[self.move]
        worth = np.where(spacing > 0.0, np.minimum(1.0, self.speed * spacing), 1.0)
        return np.where(sound, worth * sigma**-2, 0.0)

    def moves(self) -> Iterator[tuple[int, slice]]:
        """Return each move that was polled on its way, and which polls are its own."""
        cut = np.flatnonzero(np.diff(self.move)) + 1
        bounds = [0, *cut.tolist(), self.move.size] if self.move.size else [0]
        for begin, end in pairwise(bounds):
            yield int(self.move[begin]), slice(begin, end)


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The n polls on the way at one set of unknowns."""

    table: MoveTable
    found: Unknowns
    parts: tuple[_Part, ...]
    residual: FloatArray  # (n,), counted minus modelled
    speed: FloatArray  # (n,), steps/s, not signed

    @classmethod
    def of(
        cls,
        table: MoveTable,
        counts: tuple[AxisCounts, AxisCounts],
        found: Unknowns,
        how: CountUnknowns,
    ) -> Self:
        """Look all polls up."""
        parts = tuple(
            _look_up(table, track, axis.some(slice(begin, begin + AT_ONCE)), found, how)
            for track, axis in zip(lay_tracks(table, found), counts, strict=True)
            for begin in range(0, axis.steps.size, AT_ONCE)
        )
        return cls(
            table,
            found,
            parts,
            np.concatenate([np.zeros(0), *(part.rows[:, -1] for part in parts)]),
            np.concatenate([np.zeros(0), *(part.speed for part in parts)]),
        )

    def scatter_s(self, before_s: float) -> float:
        """Return the instant's scatter that the residuals show, robustly."""
        residual, speed = self.residual, self.speed
        variance = STEP_VARIANCE + (speed * before_s) ** 2
        near = np.abs(residual) < 5.0 * np.sqrt(variance) + 1.0
        if near.sum() < FEWEST:
            return before_s
        residual, speed, variance = residual[near], speed[near], variance[near]
        weight = speed**2 / variance**2
        excess = float(np.sum(weight * (residual**2 - STEP_VARIANCE)))
        found = excess / float(np.sum(weight * speed**2))
        return float(np.sqrt(max(found, 1e-12)))

    def explained(self, scatter_s: float) -> bool:
        """True when nine in ten counts lie within five deviations of the told motion."""
        if not self.residual.size:
            return True
        limit = 5.0 * np.sqrt(STEP_VARIANCE + (self.speed * scatter_s) ** 2) + 1.0
        return bool(np.mean(np.abs(self.residual) < limit) > 0.9) and scatter_s < 0.05

    def log_likelihood(self, scatter_s: float, spacing_s: FloatArray) -> float:
        """Return the log likelihood of the polls, those of one step sharing their vote."""
        total = 0.0
        for part in self.parts:
            weight = part.weight(scatter_s, spacing_s)
            variance = STEP_VARIANCE + (part.speed * scatter_s) ** 2
            square = part.rows[:, -1] ** 2 + variance * np.log(variance)
            total -= 0.5 * float(np.sum(weight * square))
        return total

    def spacing_s(self) -> FloatArray:
        """Return the usual time between the polls of each move, 0 where it was hardly polled."""
        gaps, moves = [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
        for part in self.parts:
            same = part.move[1:] == part.move[:-1]
            gaps.append(np.diff(part.at_s)[same])
            moves.append(part.move[1:][same])
        together = np.concatenate(gaps), np.concatenate(moves)
        return grouped_median(*together, len(self.table.moves), fewest=2)

    def equations(self, scatter_s: float, spacing_s: FloatArray) -> Chain:
        """Return the equations of all unknowns, without any prior.

        Args:
            scatter_s: of the instants, standard deviation.
            spacing_s: of each move's polls.
        """
        table = self.table
        chain = Chain.over(table, table.classes + 2 + COUNT_UNKNOWNS)
        plain, grams = [], []
        for part in self.parts:
            weight = part.weight(scatter_s, spacing_s)
            for k, at in part.moves():
                if table.plain[k]:
                    rows = part.rows[at]
                    plain.append(k)
                    grams.append((rows.T * weight[at]) @ rows)
                else:
                    local, shared, rows = self._several(k, part, at)
                    chain.add(local, shared, ((rows.T * weight[at]) @ rows)[None])
        if plain:
            chain.add(*self._unknowns(np.array(plain)), np.array(grams))
        return chain

    def _unknowns(self, moves: IntArray) -> tuple[IntArray, IntArray]:
        """Return the local and shared unknowns of moves of one order, as `rows` has them."""
        table = self.table
        rest = table.starts
        local = [table.first[moves], rest + table.departure[moves], rest + table.arrival[moves]]
        count = table.classes + 2 + np.arange(COUNT_UNKNOWNS)
        shared = [table.speed_class[moves], table.classes + table.axis[moves]]
        shared += [np.full(moves.size, k) for k in count]
        return np.stack(local, axis=1), np.stack(shared, axis=1)

    def _several(self, k: int, part: _Part, at: slice) -> tuple[IntArray, IntArray, FloatArray]:
        """Return unknowns and rows of a move with orders on the way, numerically."""
        table, found = self.table, self.found
        move, own = table.moves[k], table.orders(k)
        log_ramp = float(found.log_acceleration[move.axis])
        by = slopes(move, found.starts_s[own], found.log_speed, log_ramp, part.at_s[at])
        rows = [
            by.starts.T,
            part.rows[at, 1:3],
            by.speeds.T,
            by.acceleration[:, None],
            part.rows[at, 5:],
        ]
        rest = table.starts
        local = [*range(own.start, own.stop), rest + table.departure[k], rest + table.arrival[k]]
        count = table.classes + 2 + np.arange(COUNT_UNKNOWNS)
        shared = [*move.classes, table.classes + move.axis, *count]
        return np.array([local]), np.array([shared]), np.concatenate(rows, axis=1)


def grouped_median(
    values: FloatArray, group: IntArray, groups: int, fewest: int = 1, empty: float = 0.0
) -> FloatArray:
    """Return the median of each group's values, `empty` where there are less than `fewest`."""
    order = np.lexsort((values, group))
    ordered = values[order]
    count = np.bincount(group, minlength=groups)
    first = np.cumsum(count) - count
    found = np.full(groups, empty)
    enough = count >= max(1, fewest)
    first, count = first[enough], count[enough]
    found[enough] = 0.5 * (ordered[first + (count - 1) // 2] + ordered[first + count // 2])
    return found


def _look_up(
    table: MoveTable, track: Track, counts: AxisCounts, found: Unknowns, how: CountUnknowns
) -> _Part:
    """Return what those counts say that were taken on the way."""
    at_s = counts.base_s + how.late_share * counts.extra_s
    spots = track.at(at_s)
    near = np.flatnonzero(spots.moving)
    spots = spots.only(near)
    move, speed, share, steps = spots.move, spots.speed_steps_s, spots.share, spots.steps
    before = found.rest_steps[table.departure[move]]
    told = steps - before - share * (found.rest_steps[table.arrival[move]] - before)
    edge = np.minimum(np.abs(told - table.from_steps[move]), np.abs(told - table.to_steps[move]))
    use = np.flatnonzero((speed != 0.0) & (edge > EDGE_STEPS))
    if np.any(move[1:] < move[:-1]):
        use = use[np.argsort(move[use], kind="stable")]
    near, spots = near[use], spots.only(use)
    move, speed, share, steps = move[use], speed[use], share[use], steps[use]
    sign = np.sign(speed)
    rows = np.empty((use.size, 9))
    rows[:, 0], rows[:, 1], rows[:, 2] = -speed, 1.0 - share, share
    rows[:, 3], rows[:, 4] = spots.by_speed, spots.by_acceleration
    rows[:, 5], rows[:, 6], rows[:, 7] = 1.0, -sign, speed * counts.extra_s[near]
    rows[:, 8] = counts.steps[near] - steps - how.offset_steps + sign * how.lag_steps
    return _Part(move, at_s[near], np.abs(speed), rows)
