"""Derivatives of the stage rate by the unknown parameters of the moves of one axis.

Only moves and rests in the window are evaluated; the cost is proportional to the window and
does not depend on the length of the recording.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.reference.reference_motion import LocalDerivative
from gyrorig_solver.reference.unit.axis_trajectory import SampledTrajectory
from gyrorig_solver.reference.unit.motion_law import MotionLaw
from gyrorig_solver.reference.unit.move_table import MotionParameters, MoveTable
from gyrorig_solver.reference.unit.profile_derivatives import (
    ProfileDerivatives,
    differentiate_move,
)
from gyrorig_solver.reference.unit.stage_kinematics import StageRateJacobian


@dataclass(frozen=True, slots=True, eq=False)
class MoveInWindow:
    """One move in a window."""

    move: int  # among all moves
    intervals: slice  # intervals of the window with the move
    samples: SampledTrajectory  # the edges in motion
    edges_before: int  # edges of these intervals before the move, 0 or 1
    edges_after: int  # edges after the move

    def pad_to_edges(self, values: FloatArray, value_after: float = 0.0) -> FloatArray:
        """Return values at all edges: 0 before the move, `value_after` after it."""
        padded = np.empty(self.edges_before + values.size + self.edges_after)
        padded[: self.edges_before] = 0.0
        padded[self.edges_before : self.edges_before + values.size] = values
        padded[self.edges_before + values.size :] = value_after
        return padded


class AxisDerivatives:
    """The derivatives by the unknowns of one axis in one window."""

    def __init__(
        self,
        axis: int,
        table: MoveTable,
        parameters: MotionParameters,
        samples: SampledTrajectory,
        edges_s: FloatArray,
        jacobian: StageRateJacobian,
    ) -> None:
        """Select the moves in the window.

        Args:
            axis: 0 pan, 1 tilt.
            table: the moves.
            parameters: the values of their unknowns.
            samples: the trajectory of the axis at the edges.
            edges_s: of the window, shape (n + 1,).
            jacobian: derivative of the stage rate by the axis position.
        """
        self._axis, self._table, self._parameters = axis, table, parameters
        self._edges_s, self._turn = edges_s, jacobian
        track = samples.trajectory
        # The moves that overlap with the window.
        first = int(np.searchsorted(track.end_s, edges_s[0], side="right"))
        stop = max(first, int(np.searchsorted(track.begin_s, edges_s[-1])))
        begin = np.searchsorted(edges_s, track.begin_s[first:stop])
        # A move ends at the latest when the next one starts.
        end = np.searchsorted(edges_s, track.end_s[first:stop])
        end = np.minimum(end, np.append(begin[1:], edges_s.size))
        self._first, self._stop = first, stop
        self.moves: list[MoveInWindow] = []
        for n, (low, high) in enumerate(zip(begin.tolist(), end.tolist(), strict=True)):
            at = slice(max(0, low - 1), min(edges_s.size - 1, high))
            inside = samples.subset(slice(low, high))
            move = int(track.moves[first + n])
            ends = (low - at.start, at.stop + 1 - high)
            self.moves.append(MoveInWindow(move, at, inside, *ends))

    def by_starts(self, shared: FloatArray) -> Iterator[LocalDerivative]:
        """Yield the derivatives by start times; add those by speed and acceleration to `shared`.

        Args:
            shared: (classes + 2, n, 3), rows of the speed classes, then of the accelerations.
        """
        table = self._table
        for move in self.moves:
            k, intervals, samples = move.move, move.intervals, move.samples
            if table.has_single_command[k]:
                starts = [move.pad_to_edges(-samples.speed_steps_s)]
                speeds = [move.pad_to_edges(samples.by_speed)]
                acceleration = move.pad_to_edges(samples.by_acceleration)
            else:
                derivatives = self._profile_derivatives(k, intervals)
                starts = list(derivatives.starts)
                speeds = list(derivatives.speeds)
                acceleration = derivatives.acceleration
            for row, slope in zip(table.speed_classes(k), speeds, strict=True):
                shared[row, intervals] += self._stage_rate(slope, intervals)
            shared[table.speed_class_count + self._axis, intervals] += self._stage_rate(
                acceleration, intervals
            )
            for n, slope in enumerate(starts, start=int(table.first_command[k])):
                yield LocalDerivative(n, intervals.start, self._stage_rate(slope, intervals))

    def add_by_law(self, law_rates: FloatArray, law: MotionLaw) -> None:
        """Add the derivatives by the values of a motion law, in steps and seconds.

        Args:
            law_rates: (6, n, 3), in the order of `LAW_QUANTITIES`.
            law: motion law that the motion follows.
        """
        share = law.acceleration_share[self._axis]
        for move in self.moves:
            k, intervals, samples = move.move, move.intervals, move.samples
            if self._table.has_single_command[k]:
                acceleration = move.pad_to_edges(samples.by_acceleration)
                base_speed = move.pad_to_edges(samples.by_base_speed)
            else:
                derivatives = self._profile_derivatives(k, intervals)
                acceleration, base_speed = derivatives.acceleration, derivatives.base_speed
            slopes = acceleration / (1.0 + share), base_speed, move.pad_to_edges(samples.by_corner)
            for quantity, slope in enumerate(slopes):
                row = 2 * quantity + self._axis
                law_rates[row, intervals] += self._stage_rate(slope, intervals)

    def by_rests(self) -> Iterator[LocalDerivative]:
        """Yield the derivatives by the position at each rest.

        The share of a rest rises during the arriving move and falls during the departing move.
        Between them a tilt offset changes the direction of the pan rate; a pan offset has no
        effect.
        """
        intervals = self._edges_s.size - 1
        unknown = self._table.command_count + self._table.first_rest(self._axis)
        progress = [
            (
                move.intervals,
                self._stage_rate(move.pad_to_edges(move.samples.progress, 1.0), move.intervals),
            )
            for move in self.moves
        ]
        for n in range(len(progress) + 1):
            arriving = progress[n - 1] if n > 0 else None
            leaving = progress[n] if n < len(progress) else None
            standstill = slice(
                arriving[0].stop if arriving else 0, leaving[0].stop if leaving else intervals
            )
            if self._axis == 0 and leaving is None:
                standstill = slice(standstill.start, standstill.start)
            if self._axis == 0 and arriving is None:
                standstill = slice(
                    leaving[0].start if leaving else standstill.stop, standstill.stop
                )
            begin = arriving[0].start if arriving else standstill.start
            values = np.zeros((max(standstill.stop, standstill.start) - begin, 3))
            if values.size == 0:
                continue
            if arriving:
                values[: arriving[0].stop - begin] = arriving[1]
            if self._axis == 1 and standstill.stop > standstill.start:
                values[standstill.start - begin :] += self._stage_rate(
                    np.ones(standstill.stop - standstill.start + 1), standstill
                )
            if leaving:
                values[leaving[0].start - begin : leaving[0].stop - begin] -= leaving[1]
            yield LocalDerivative(unknown + self._first + n, begin, values)

    def _profile_derivatives(self, k: int, intervals: slice) -> ProfileDerivatives:
        """Return the derivatives of a move with several commands."""
        return differentiate_move(
            self._table.moves[k],
            self._parameters.start_times_s[self._table.commands_of(k)],
            self._parameters.log_speed,
            float(self._parameters.log_acceleration[self._axis]),
            self._edges_s[intervals.start : intervals.stop + 1],
        )

    def _stage_rate(self, change_steps: FloatArray, intervals: slice) -> FloatArray:
        return self._turn.rate(self._axis, change_steps, intervals)
