"""What the polled counts say of a motion at given unknowns: residuals, slopes, equations.

Only polls of moving axes take part: at rest a count carries no time. All polls of one axis
are looked up at once; only moves with orders on the way are differentiated one by one.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.reference.chain import Chain
from gyrorig_solver.reference.slopes import slopes
from gyrorig_solver.reference.table import MoveTable, Unknowns
from gyrorig_solver.reference.track import lay_tracks

STEP_VARIANCE = 1.0 / 12.0
EDGE_STEPS = 1.5  # counts this near to a rest are rounded one way and say little
COUNT_UNKNOWNS = 3  # the count's offset, its lag, and phi: the last shared ones
FEWEST = 10  # residuals that show a scatter


@dataclass(frozen=True, slots=True, eq=False)
class AxisCounts:
    """The answered counts of one axis, in the order of time."""

    base_s: FloatArray  # (n,), the instant where no extra delay lies before it
    extra_s: FloatArray  # (n,), width of the exchange beyond the least
    steps: FloatArray  # (n,)


@dataclass(frozen=True, slots=True, eq=False)
class CountUnknowns:
    """How counts follow the motion."""

    offset_steps: float
    lag_steps: float
    late_share: float  # phi


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The n polls on the way at one set of unknowns, move by move."""

    table: MoveTable
    found: Unknowns
    move: IntArray  # (n,)
    at_s: FloatArray  # (n,)
    speed: FloatArray  # (n,), steps/s, not signed
    # Slopes by start, rest before, rest after, log speed, log acceleration, offset, lag and
    # phi, then the residual.
    rows: FloatArray  # (n, 9)

    @classmethod
    def of(
        cls,
        table: MoveTable,
        counts: tuple[AxisCounts, AxisCounts],
        found: Unknowns,
        how: CountUnknowns,
    ) -> Self:
        """Look all polls up."""
        parts = []
        for track, axis in zip(lay_tracks(table, found), counts, strict=True):
            at_s = axis.base_s + how.late_share * axis.extra_s
            spots = track.at(at_s)
            near = np.flatnonzero(spots.moving)
            spots = spots.only(near)
            move, speed, share, steps = spots.move, spots.speed_steps_s, spots.share, spots.steps
            before = found.rest_steps[table.departure[move]]
            told = steps - before - share * (found.rest_steps[table.arrival[move]] - before)
            edge = np.minimum(
                np.abs(told - table.from_steps[move]), np.abs(told - table.to_steps[move])
            )
            use = np.flatnonzero((speed != 0.0) & (edge > EDGE_STEPS))
            near, spots = near[use], spots.only(use)
            move, speed, share, steps = move[use], speed[use], share[use], steps[use]
            sign = np.sign(speed)
            rows = np.empty((use.size, 9))
            rows[:, 0], rows[:, 1], rows[:, 2] = -speed, 1.0 - share, share
            rows[:, 3], rows[:, 4] = spots.by_speed, spots.by_acceleration
            rows[:, 5], rows[:, 6], rows[:, 7] = 1.0, -sign, speed * axis.extra_s[near]
            rows[:, 8] = axis.steps[near] - steps - how.offset_steps + sign * how.lag_steps
            part = (move, at_s[near], np.abs(speed), rows)
            if np.any(move[1:] < move[:-1]):
                order = np.argsort(move, kind="stable")
                part = (move[order], part[1][order], part[2][order], rows[order])
            parts.append(part)
        move, at_s, speed, rows = (np.concatenate(p) for p in zip(*parts, strict=True))
        return cls(table, found, move, at_s, speed, rows)

    @property
    def residual(self) -> FloatArray:
        """Counted minus modelled, shape (n,)."""
        return self.rows[:, -1]

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

    def spacing_s(self) -> FloatArray:
        """Return the usual time between the polls of each move, 0 where it was hardly polled."""
        same = self.move[1:] == self.move[:-1]
        gaps, move = np.diff(self.at_s)[same], self.move[1:][same]
        return grouped_median(gaps, move, len(self.table.moves), fewest=2)

    def equations(self, scatter_s: float, spacing_s: FloatArray) -> Chain:
        """Return the equations of all unknowns, without any prior.

        Args:
            scatter_s: of the instants, standard deviation.
            spacing_s: of each move's polls.
        """
        table = self.table
        sigma = np.sqrt(STEP_VARIANCE + (self.speed * scatter_s) ** 2)
        # A count that cannot be (a garbled reply) has no vote. Polls of one and the same
        # step repeat each other's rounding and share theirs.
        sound = np.abs(self.residual) < 6.0 * sigma + 1.0
        spacing = spacing_s[self.move]
        worth = np.where(spacing > 0.0, np.minimum(1.0, self.speed * spacing), 1.0)
        weight = np.where(sound, worth * sigma**-2, 0.0)
        chain = Chain.over(table, table.classes + 2 + COUNT_UNKNOWNS)
        plain, grams = [], []
        for k, at in self._moves():
            if table.plain[k]:
                plain.append(k)
                rows = self.rows[at]
                grams.append((rows.T * weight[at]) @ rows)
            else:
                local, shared, rows = self._several(k, at)
                chain.add(local, shared, ((rows.T * weight[at]) @ rows)[None])
        if plain:
            chain.add(*self._unknowns(np.array(plain)), np.array(grams))
        return chain

    def _moves(self) -> Iterator[tuple[int, slice]]:
        """Return each move that was polled on its way, and which polls are its own."""
        cut = np.flatnonzero(np.diff(self.move)) + 1
        bounds = [0, *cut.tolist(), self.move.size] if self.move.size else [0]
        for begin, end in pairwise(bounds):
            yield int(self.move[begin]), slice(begin, end)

    def _unknowns(self, moves: IntArray) -> tuple[IntArray, IntArray]:
        """Return the local and shared unknowns of moves of one order, as `rows` has them."""
        table = self.table
        rest = table.starts
        local = [table.first[moves], rest + table.departure[moves], rest + table.arrival[moves]]
        count = table.classes + 2 + np.arange(COUNT_UNKNOWNS)
        shared = [table.speed_class[moves], table.classes + table.axis[moves]]
        shared += [np.full(moves.size, k) for k in count]
        return np.stack(local, axis=1), np.stack(shared, axis=1)

    def _several(self, k: int, at: slice) -> tuple[IntArray, IntArray, FloatArray]:
        """Return unknowns and rows of a move with orders on the way, numerically."""
        table, found = self.table, self.found
        move, own = table.moves[k], table.orders(k)
        log_ramp = float(found.log_acceleration[move.axis])
        by = slopes(move, found.starts_s[own], found.log_speed, log_ramp, self.at_s[at])
        rows = [
            by.starts.T,
            self.rows[at, 1:3],
            by.speeds.T,
            by.acceleration[:, None],
            self.rows[at, 5:],
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
