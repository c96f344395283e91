"""The moves of a motion as arrays: what thousands of them are computed from at once."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.reference.moves import Motion, Move


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """What a motion's courses need to be laid."""

    starts_s: FloatArray  # (s,)
    rest_steps: FloatArray  # (r,), off the count
    log_speed: FloatArray  # (classes,)
    log_acceleration: FloatArray  # (2,)


@dataclass(frozen=True, slots=True, eq=False)
class MoveTable:
    """m moves with s starts (one for each order), and r rests between them.

    Starts are numbered by move, rests by axis and time, as in `Motion.rests`.
    """

    moves: tuple[Move, ...]
    rest_steps: tuple[int, int]  # where pan and tilt stood first
    recounts: tuple[tuple[float, int, int], ...]  # time, axis, count after homing
    classes: int
    told_s: FloatArray  # (s,)
    first: IntArray  # (m + 1,), each move's first start
    axis: IntArray  # (m,)
    from_steps: FloatArray  # (m,)
    to_steps: FloatArray  # (m,)
    speed: FloatArray  # (m,), told with the first order
    speed_class: IntArray  # (m,)
    acceleration: FloatArray  # (m,)
    base: FloatArray  # (m,)
    plain: BoolArray  # (m,), True for one order
    own: tuple[IntArray, IntArray]  # each axis' moves
    departure: IntArray  # (m,), the rest that a move leaves
    arrival: IntArray  # (m,), the rest that it comes to

    @classmethod
    def of(cls, motion: Motion) -> Self:
        """Return the table of a motion."""
        moves = motion.moves
        rows = [
            (
                m.axis,
                m.from_steps,
                m.to_steps,
                m.orders[0].speed_steps_s,
                m.orders[0].speed_class,
                m.acceleration_steps_s2,
                m.base_speed_steps_s,
                len(m.orders),
            )
            for m in moves
        ]
        columns = np.array(rows, dtype=np.float64).reshape(-1, 8).T
        axis, count = columns[0].astype(np.int64), columns[7].astype(np.int64)
        own = (np.flatnonzero(axis == 0), np.flatnonzero(axis == 1))
        departure = np.zeros(len(moves), dtype=np.int64)
        departure[own[0]] = np.arange(own[0].size)
        departure[own[1]] = own[0].size + 1 + np.arange(own[1].size)
        return cls(
            moves=moves,
            rest_steps=motion.rest_steps,
            recounts=motion.recounts,
            classes=motion.classes,
            told_s=np.array([order.told_s for m in moves for order in m.orders], dtype=np.float64),
            first=np.concatenate([[0], np.cumsum(count)]).astype(np.int64),
            axis=axis,
            from_steps=columns[1],
            to_steps=columns[2],
            speed=columns[3],
            speed_class=columns[4].astype(np.int64),
            acceleration=columns[5],
            base=columns[6],
            plain=count == 1,
            own=own,
            departure=departure,
            arrival=departure + 1,
        )

    @property
    def starts(self) -> int:
        """How many orders there are."""
        return self.told_s.size

    @property
    def rests(self) -> int:
        """How many rests there are, one more than moves on each axis."""
        return len(self.moves) + 2

    @property
    def as_told(self) -> Unknowns:
        """What the courses would be if every order took hold when it was written."""
        return Unknowns(self.told_s, np.zeros(self.rests), np.zeros(self.classes), np.zeros(2))

    def first_rest(self, axis: int) -> int:
        """Return the number of an axis' first rest."""
        return self.own[0].size + 1 if axis else 0

    @property
    def several(self) -> IntArray:
        """The moves with orders on the way."""
        return np.flatnonzero(~self.plain)

    def speed_classes(self, move: int) -> tuple[int, ...]:
        """Return the speed classes that take part in a move, each once."""
        return (int(self.speed_class[move]),) if self.plain[move] else self.moves[move].classes

    def orders(self, move: int) -> slice:
        """Return which starts are a move's."""
        return slice(int(self.first[move]), int(self.first[move + 1]))
