"""How the stage rate over a window changes with what is not known of one axis' moves.

Only moves and rests that touch the window are looked at: a window costs in proportion to
itself, whatever the length of the recording.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.reference.kinematics import AxisTurn
from gyrorig_solver.reference.motion import LocalColumn
from gyrorig_solver.reference.slopes import slopes
from gyrorig_solver.reference.table import MoveTable, Unknowns
from gyrorig_solver.reference.track import Spots


@dataclass(frozen=True, slots=True, eq=False)
class Touching:
    """One move inside a window."""

    number: int  # among the moves of its axis
    move: int  # among all
    at: slice  # intervals that it touches
    spots: Spots  # the edges on its way
    before: int  # edges of those intervals before it sets off, 0 or 1
    after: int  # edges after it has come

    def filled(self, values: FloatArray, after: float = 0.0) -> FloatArray:
        """Return values at all edges of the intervals: 0 before the move, `after` after it."""
        whole = np.empty(self.before + values.size + self.after)
        whole[: self.before] = 0.0
        whole[self.before : self.before + values.size] = values
        whole[self.before + values.size :] = after
        return whole


class AxisColumns:
    """The derivatives by the unknowns of one axis over one window."""

    def __init__(
        self,
        axis: int,
        table: MoveTable,
        found: Unknowns,
        spots: Spots,
        edges_s: FloatArray,
        turn: AxisTurn,
    ) -> None:
        """Look up the moves that touch the window.

        Args:
            axis: 0 pan, 1 tilt.
            table: the moves.
            found: their unknowns' values.
            spots: the edges on the axis' track.
            edges_s: of the window, shape (n + 1,).
            turn: how the axis changes the stage rate.
        """
        self._axis, self._table, self._found = axis, table, found
        self._edges_s, self._turn = edges_s, turn
        track = spots.track
        # The moves that end behind the window's begin and begin before its end.
        first = int(np.searchsorted(track.end_s, edges_s[0], side="right"))
        stop = max(first, int(np.searchsorted(track.begin_s, edges_s[-1])))
        begin = np.searchsorted(edges_s, track.begin_s[first:stop])
        # A move that is not over when the next one begins gives way.
        over = np.searchsorted(edges_s, track.end_s[first:stop])
        over = np.minimum(over, np.append(begin[1:], edges_s.size))
        self._first, self._stop = first, stop
        self.touching: list[Touching] = []
        for n, (low, high) in enumerate(zip(begin.tolist(), over.tolist(), strict=True)):
            at = slice(max(0, low - 1), min(edges_s.size - 1, high))
            own = spots.only(slice(low, high))
            move = int(track.moves[first + n])
            ends = (low - at.start, at.stop + 1 - high)
            self.touching.append(Touching(first + n, move, at, own, *ends))

    def starts(self, shared: FloatArray) -> Iterator[LocalColumn]:
        """Return the columns by starts; add those by speeds and accelerations to `shared`.

        Args:
            shared: (classes + 2, n, 3), the classes' rows, then pan's and tilt's acceleration.
        """
        table = self._table
        for touching in self.touching:
            k, at, spots = touching.move, touching.at, touching.spots
            if table.plain[k]:
                starts = [touching.filled(-spots.speed_steps_s)]
                speeds = [touching.filled(spots.by_speed)]
                acceleration = touching.filled(spots.by_acceleration)
            else:
                own = table.orders(k)
                by = slopes(
                    table.moves[k],
                    self._found.starts_s[own],
                    self._found.log_speed,
                    float(self._found.log_acceleration[self._axis]),
                    self._edges_s[at.start : at.stop + 1],
                )
                starts, speeds, acceleration = list(by.starts), list(by.speeds), by.acceleration
            for row, slope in zip(table.speed_classes(k), speeds, strict=True):
                shared[row, at] += self._rate(slope, at)
            shared[table.classes + self._axis, at] += self._rate(acceleration, at)
            for n, slope in enumerate(starts, start=int(table.first[k])):
                yield LocalColumn(n, at.start, self._rate(slope, at))

    def rests(self) -> Iterator[LocalColumn]:
        """Return the columns by where the stage stands at each rest.

        The share of a rest rises with the arriving move's way and falls with the leaving
        one's. Between them a tilt leans what pan turns; a pan changes no rate.
        """
        intervals = self._edges_s.size - 1
        unknown = self._table.starts + self._table.first_rest(self._axis)
        shares = [(t.at, self._rate(t.filled(t.spots.share, 1.0), t.at)) for t in self.touching]
        for n in range(len(shares) + 1):
            came = shares[n - 1] if n > 0 else None
            goes = shares[n] if n < len(shares) else None
            stood = slice(came[0].stop if came else 0, goes[0].stop if goes else intervals)
            if self._axis == 0 and goes is None:
                stood = slice(stood.start, stood.start)
            if self._axis == 0 and came is None:
                stood = slice(goes[0].start if goes else stood.stop, stood.stop)
            begin = came[0].start if came else stood.start
            values = np.zeros((max(stood.stop, stood.start) - begin, 3))
            if values.size == 0:
                continue
            if came:
                values[: came[0].stop - begin] = came[1]
            if self._axis == 1 and stood.stop > stood.start:
                values[stood.start - begin :] += self._rate(
                    np.ones(stood.stop - stood.start + 1), stood
                )
            if goes:
                values[goes[0].start - begin : goes[0].stop - begin] -= goes[1]
            yield LocalColumn(unknown + self._first + n, begin, values)

    def _rate(self, change_steps: FloatArray, at: slice) -> FloatArray:
        return self._turn.rate(self._axis, change_steps, at)
