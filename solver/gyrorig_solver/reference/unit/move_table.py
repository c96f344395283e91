"""The moves of a motion as arrays, for vectorised computation."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.reference.unit.motion_law import MotionLaw
from gyrorig_solver.reference.unit.unit_moves import Move, UnitMotion


@dataclass(frozen=True, slots=True, eq=False)
class MotionParameters:
    """The unknown parameters of a motion."""

    start_times_s: FloatArray  # (s,)
    rest_offset_steps: FloatArray  # (r,), relative to the count
    log_speed: FloatArray  # (classes,)
    log_acceleration: FloatArray  # (2,)


@dataclass(frozen=True, slots=True, eq=False)
class MoveTable:
    """m moves with s commands, and r rests between them.

    Commands are numbered by move, rests by axis and time.
    """

    moves: tuple[Move, ...]
    initial_steps: tuple[int, int]  # pan and tilt before the first move
    count_resets: tuple[tuple[float, int, int], ...]  # time, axis, count after homing
    speed_class_count: int
    command_times_s: FloatArray  # (s,)
    first_command: IntArray  # (m + 1,), first command of each move
    axis: IntArray  # (m,)
    from_steps: FloatArray  # (m,)
    to_steps: FloatArray  # (m,)
    speed_steps_s: FloatArray  # (m,), of the first command
    speed_class: IntArray  # (m,)
    acceleration_steps_s2: FloatArray  # (m,)
    base_speed_steps_s: FloatArray  # (m,)
    has_single_command: BoolArray  # (m,), True for a single command
    moves_of_axis: tuple[IntArray, IntArray]  # moves of each axis
    departure: IntArray  # (m,), rest before a move
    arrival: IntArray  # (m,), rest after a move

    @classmethod
    def of(cls, motion: UnitMotion) -> Self:
        """Return the table of a motion."""
        moves = motion.moves
        rows = [
            (
                move.axis,
                move.from_steps,
                move.to_steps,
                move.commands[0].speed_steps_s,
                move.commands[0].speed_class,
                move.acceleration_steps_s2,
                move.base_speed_steps_s,
                len(move.commands),
            )
            for move in moves
        ]
        columns = np.array(rows, dtype=np.float64).reshape(-1, 8).T
        axis, count = columns[0].astype(np.int64), columns[7].astype(np.int64)
        moves_of_axis = (np.flatnonzero(axis == 0), np.flatnonzero(axis == 1))
        departure = np.zeros(len(moves), dtype=np.int64)
        departure[moves_of_axis[0]] = np.arange(moves_of_axis[0].size)
        departure[moves_of_axis[1]] = moves_of_axis[0].size + 1 + np.arange(moves_of_axis[1].size)
        return cls(
            moves=moves,
            initial_steps=motion.initial_steps,
            count_resets=motion.count_resets,
            speed_class_count=motion.speed_class_count,
            command_times_s=np.array(
                [command.command_time_s for move in moves for command in move.commands],
                dtype=np.float64,
            ),
            first_command=np.concatenate([[0], np.cumsum(count)]).astype(np.int64),
            axis=axis,
            from_steps=columns[1],
            to_steps=columns[2],
            speed_steps_s=columns[3],
            speed_class=columns[4].astype(np.int64),
            acceleration_steps_s2=columns[5],
            base_speed_steps_s=columns[6],
            has_single_command=count == 1,
            moves_of_axis=moves_of_axis,
            departure=departure,
            arrival=departure + 1,
        )

    @property
    def command_count(self) -> int:
        """Number of commands."""
        return self.command_times_s.size

    @property
    def rest_count(self) -> int:
        """Number of rests, one more than moves on each axis."""
        return len(self.moves) + 2

    @property
    def commanded_parameters(self) -> MotionParameters:
        """The parameters if every command acts at the time of its request."""
        return MotionParameters(
            self.command_times_s,
            np.zeros(self.rest_count),
            np.zeros(self.speed_class_count),
            np.zeros(2),
        )

    def with_law(self, law: MotionLaw) -> "MoveTable":
        """Return the moves with the limits of a motion law; rounded corners are not a limit."""
        factor = 1.0 + np.array(law.acceleration_share)[self.axis]
        base_steps_s = self.base_speed_steps_s + np.array(law.base_speed_steps_s)[self.axis]
        moves = tuple(move.with_law(law) for move in self.moves)
        return replace(
            self,
            moves=moves,
            acceleration_steps_s2=self.acceleration_steps_s2 * factor,
            base_speed_steps_s=np.maximum(0.0, base_steps_s),
        )

    def first_rest(self, axis: int) -> int:
        """Return the number of an axis' first rest."""
        return self.moves_of_axis[0].size + 1 if axis else 0

    @property
    def multi_command_moves(self) -> IntArray:
        """The moves with several commands."""
        return np.flatnonzero(~self.has_single_command)

    def speed_classes(self, move: int) -> tuple[int, ...]:
        """Return the speed classes of a move, each once."""
        return (
            (int(self.speed_class[move]),)
            if self.has_single_command[move]
            else self.moves[move].speed_classes
        )

    def commands_of(self, move: int) -> slice:
        """Return the slice of the commands of a move."""
        return slice(int(self.first_command[move]), int(self.first_command[move + 1]))
