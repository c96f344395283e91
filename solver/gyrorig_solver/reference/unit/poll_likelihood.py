"""Likelihood of the polled counts: residuals, derivatives and normal equations.

Only polls of moving axes are used, because a count at rest contains no information about time.
All polls of an axis are evaluated together; only moves with several commands are differentiated
one by one.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.reference.unit.axis_trajectory import Trajectory
from gyrorig_solver.reference.unit.motion_law import LAW_QUANTITIES, LAW_VALUES, MotionLaw
from gyrorig_solver.reference.unit.move_equations import BandedNormalEquations
from gyrorig_solver.reference.unit.move_table import MotionParameters, MoveTable
from gyrorig_solver.reference.unit.profile_derivatives import differentiate_move
from gyrorig_solver.reference.unit.rounded_trajectory import build_executed_trajectories

STEP_VARIANCE = 1.0 / 12.0
# Closer counts are not used: near a rest, they are rounded in one direction. The distance is a
# whole number of steps, because the mean rounding error is half a step over whole steps only.
MIN_REST_DISTANCE_STEPS = 2.0
COUNT_PARAMETERS = 3  # offset, lag and phi, the last shared unknowns
POLLS_PER_PIECE = 1 << 16  # a limit on memory
MIN_RESIDUALS = 10  # for an estimate of the scatter


@dataclass(frozen=True, slots=True, eq=False)
class AxisCounts:
    """The polled counts of one axis, in the order of time."""

    base_s: FloatArray  # (n,), sampling time without extra delay
    extra_s: FloatArray  # (n,), width of the exchange minus the smallest width
    steps: FloatArray  # (n,)

    def subset(self, selection: slice | BoolArray | IntArray) -> "AxisCounts":
        """Return the selected counts."""
        return AxisCounts(self.base_s[selection], self.extra_s[selection], self.steps[selection])


@dataclass(frozen=True, slots=True, eq=False)
class CountParameters:
    """Relation of counts and motion: offset, lag and share of the delay before sampling."""

    offset_steps: float
    lag_steps: float
    delay_share: float  # phi


@dataclass(frozen=True, slots=True, eq=False)
class _PollPiece:
    """Polls of one axis in motion, sorted by move."""

    move: IntArray  # (n,)
    at_s: FloatArray  # (n,)
    speed: FloatArray  # (n,), steps/s, not signed
    # Derivatives by start, rest before, rest after, log speed, log acceleration, offset, lag
    # and phi, by the values of the law if it differs from the settings, then the residual.
    derivatives: FloatArray  # (n, 9) or (n, 12)
    counts: AxisCounts  # (n,)

    def weight(self, scatter_s: float, spacing_s: FloatArray) -> FloatArray:
        """Return the weight of each poll, shape (n,)."""
        sigma = np.sqrt(STEP_VARIANCE + (self.speed * scatter_s) ** 2)
        # An impossible count (a garbled reply) gets no weight. Polls of the same step have the
        # same rounding error and share one weight.
        is_plausible = np.abs(self.derivatives[:, -1]) < 6.0 * sigma + 1.0
        spacing = spacing_s[self.move]
        share = np.where(spacing > 0.0, np.minimum(1.0, self.speed * spacing), 1.0)
        return np.where(is_plausible, share * sigma**-2, 0.0)

    def by_move(self) -> Iterator[tuple[int, slice]]:
        """Yield each polled move and the slice of its polls."""
        cut = np.flatnonzero(np.diff(self.move)) + 1
        bounds = [0, *cut.tolist(), self.move.size] if self.move.size else [0]
        for begin, end in pairwise(bounds):
            yield int(self.move[begin]), slice(begin, end)


@dataclass(frozen=True, slots=True, eq=False)
class PollLikelihood:
    """The n polls in motion, evaluated at one set of parameters."""

    table: MoveTable  # with the limits of the law
    parameters: MotionParameters
    law: MotionLaw
    pieces: tuple[_PollPiece, ...]
    residual: FloatArray  # (n,), counts minus model
    speed: FloatArray  # (n,), steps/s, not signed

    @classmethod
    def of(
        cls,
        table: MoveTable,
        counts: tuple[AxisCounts, AxisCounts],
        parameters: MotionParameters,
        count_parameters: CountParameters,
        law: MotionLaw,
    ) -> Self:
        """Evaluate all polls."""
        trajectories = build_executed_trajectories(table, parameters, law)
        pieces = tuple(
            _evaluate_polls(
                table,
                track,
                axis.subset(slice(begin, begin + POLLS_PER_PIECE)),
                parameters,
                count_parameters,
                law,
            )
            for track, axis in zip(trajectories, counts, strict=True)
            for begin in range(0, axis.steps.size, POLLS_PER_PIECE)
        )
        return cls(
            table,
            parameters,
            law,
            pieces,
            np.concatenate([np.zeros(0), *(piece.derivatives[:, -1] for piece in pieces)]),
            np.concatenate([np.zeros(0), *(piece.speed for piece in pieces)]),
        )

    def scatter_s(self, previous_s: float) -> float:
        """Return a robust estimate of the scatter of the sampling times."""
        residual, speed = self.residual, self.speed
        variance = STEP_VARIANCE + (speed * previous_s) ** 2
        is_inlier = np.abs(residual) < 5.0 * np.sqrt(variance) + 1.0
        if is_inlier.sum() < MIN_RESIDUALS:
            return previous_s
        residual, speed, variance = residual[is_inlier], speed[is_inlier], variance[is_inlier]
        weight = speed**2 / variance**2
        excess = float(np.sum(weight * (residual**2 - STEP_VARIANCE)))
        variance_s2 = excess / float(np.sum(weight * speed**2))
        return float(np.sqrt(max(variance_s2, 1e-12)))

    def counts_follow_commands(self, scatter_s: float) -> bool:
        """Whether 90 % of the counts are within five standard deviations of the motion."""
        if not self.residual.size:
            return True
        limit = 5.0 * np.sqrt(STEP_VARIANCE + (self.speed * scatter_s) ** 2) + 1.0
        return bool(np.mean(np.abs(self.residual) < limit) > 0.9) and scatter_s < 0.05

    def log_likelihood(self, scatter_s: float, spacing_s: FloatArray) -> float:
        """Return the log-likelihood of the polls; those of one step share one weight."""
        total = 0.0
        for piece in self.pieces:
            weight = piece.weight(scatter_s, spacing_s)
            variance = STEP_VARIANCE + (piece.speed * scatter_s) ** 2
            square = piece.derivatives[:, -1] ** 2 + variance * np.log(variance)
            total -= 0.5 * float(np.sum(weight * square))
        return total

    def poll_spacing_s(self) -> FloatArray:
        """Return the median time between the polls of each move, 0 with too few polls."""
        gaps, moves = [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
        for piece in self.pieces:
            same_move = piece.move[1:] == piece.move[:-1]
            gaps.append(np.diff(piece.at_s)[same_move])
            moves.append(piece.move[1:][same_move])
        gaps_and_moves = np.concatenate(gaps), np.concatenate(moves)
        return grouped_median(*gaps_and_moves, len(self.table.moves), fewest=2)

    def normal_equations(self, scatter_s: float, spacing_s: FloatArray) -> BandedNormalEquations:
        """Return the normal equations of all unknowns, without a prior.

        If the law differs from the settings, its values are the last shared unknowns.

        Args:
            scatter_s: standard deviation of the sampling times.
            spacing_s: time between the polls of each move.
        """
        table = self.table
        shared_count = table.speed_class_count + 2 + COUNT_PARAMETERS
        if not self.law.is_recorded:
            shared_count += LAW_VALUES
        equations = BandedNormalEquations.empty(table, shared_count)
        single_moves, grams = [], []
        for piece in self.pieces:
            weight = piece.weight(scatter_s, spacing_s)
            for k, selection in piece.by_move():
                if table.has_single_command[k]:
                    derivatives = piece.derivatives[selection]
                    single_moves.append(k)
                    grams.append((derivatives.T * weight[selection]) @ derivatives)
                else:
                    local, shared, derivatives = self._multi_command_derivatives(
                        k, piece, selection
                    )
                    equations.add(
                        local, shared, ((derivatives.T * weight[selection]) @ derivatives)[None]
                    )
        if single_moves:
            equations.add(*self._unknowns_of(np.array(single_moves)), np.array(grams))
        return equations

    def _unknowns_of(self, moves: IntArray) -> tuple[IntArray, IntArray]:
        """Return the unknowns of single-command moves, in the order of `derivatives`."""
        table = self.table
        rest = table.command_count
        local = [
            table.first_command[moves],
            rest + table.departure[moves],
            rest + table.arrival[moves],
        ]
        count = table.speed_class_count + 2 + np.arange(COUNT_PARAMETERS)
        shared = [table.speed_class[moves], table.speed_class_count + table.axis[moves]]
        shared += [np.full(moves.size, k) for k in count]
        shared += [k + table.axis[moves] for k in self._first_law_unknowns]
        return np.stack(local, axis=1), np.stack(shared, axis=1)

    @property
    def _first_law_unknowns(self) -> list[int]:
        """The shared unknown of pan for each quantity of the law; that of tilt follows."""
        if self.law.is_recorded:
            return []
        first = self.table.speed_class_count + 2 + COUNT_PARAMETERS
        return [first + 2 * k for k in range(len(LAW_QUANTITIES))]

    def _multi_command_derivatives(
        self, k: int, piece: _PollPiece, selection: slice
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """Return unknowns and derivatives of a move with several commands, numerically."""
        table, parameters = self.table, self.parameters
        move, command_range = table.moves[k], table.commands_of(k)
        log_ramp = float(parameters.log_acceleration[move.axis])
        profile = differentiate_move(
            move,
            parameters.start_times_s[command_range],
            parameters.log_speed,
            log_ramp,
            piece.at_s[selection],
        )
        blocks = [
            profile.starts.T,
            piece.derivatives[selection, 1:3],
            profile.speeds.T,
            profile.acceleration[:, None],
            piece.derivatives[selection, 5:],
        ]
        if not self.law.is_recorded:
            share = self.law.acceleration_share[move.axis]
            blocks[-1] = piece.derivatives[selection, 5:].copy()
            blocks[-1][:, COUNT_PARAMETERS] = profile.acceleration / (1.0 + share)
            blocks[-1][:, COUNT_PARAMETERS + 1] = profile.base_speed
        rest = table.command_count
        local = [
            *range(command_range.start, command_range.stop),
            rest + table.departure[k],
            rest + table.arrival[k],
        ]
        count = table.speed_class_count + 2 + np.arange(COUNT_PARAMETERS)
        law = [k + move.axis for k in self._first_law_unknowns]
        shared = [*move.speed_classes, table.speed_class_count + move.axis, *count, *law]
        return np.array([local]), np.array([shared]), np.concatenate(blocks, axis=1)


def grouped_median(
    values: FloatArray, group_index: IntArray, groups: int, fewest: int = 1, empty: float = 0.0
) -> FloatArray:
    """Return the median of each group, `empty` for groups with fewer than `fewest` values."""
    order = np.lexsort((values, group_index))
    ordered = values[order]
    count = np.bincount(group_index, minlength=groups)
    first = np.cumsum(count) - count
    medians = np.full(groups, empty)
    is_large = count >= max(1, fewest)
    first, count = first[is_large], count[is_large]
    medians[is_large] = 0.5 * (ordered[first + (count - 1) // 2] + ordered[first + count // 2])
    return medians


def _evaluate_polls(
    table: MoveTable,
    track: Trajectory,
    counts: AxisCounts,
    parameters: MotionParameters,
    count_parameters: CountParameters,
    law: MotionLaw,
) -> _PollPiece:
    """Return residuals and derivatives of the counts taken in motion."""
    at_s = counts.base_s + count_parameters.delay_share * counts.extra_s
    samples = track.sample(at_s)
    moving = np.flatnonzero(samples.is_moving)
    samples = samples.subset(moving)
    move = samples.move
    speed = samples.speed_steps_s
    progress = samples.progress
    steps = samples.steps
    departure_offset = parameters.rest_offset_steps[table.departure[move]]
    planned = (
        steps
        - departure_offset
        - progress * (parameters.rest_offset_steps[table.arrival[move]] - departure_offset)
    )
    rest_distance = np.minimum(
        np.abs(planned - table.from_steps[move]), np.abs(planned - table.to_steps[move])
    )
    used = np.flatnonzero((speed != 0.0) & (rest_distance > MIN_REST_DISTANCE_STEPS))
    if np.any(move[1:] < move[:-1]):
        used = used[np.argsort(move[used], kind="stable")]
    moving, samples = moving[used], samples.subset(used)
    move, speed, progress, steps = move[used], speed[used], progress[used], steps[used]
    sign = np.sign(speed)
    derivatives = [-speed, 1.0 - progress, progress, samples.by_speed, samples.by_acceleration]
    derivatives += [np.ones(used.size), -sign, speed * counts.extra_s[moving]]
    if not law.is_recorded:
        # A speed at or below the base speed has no ramps; `by_base_speed` is zero there.
        share = np.array(law.acceleration_share)[table.axis[move]]
        derivatives += [samples.by_acceleration / (1.0 + share)]
        derivatives += [samples.by_base_speed, samples.by_corner]
    residual = (
        counts.steps[moving]
        - steps
        - count_parameters.offset_steps
        + sign * count_parameters.lag_steps
    )
    columns = np.column_stack([*derivatives, residual])
    return _PollPiece(move, at_s[moving], np.abs(speed), columns, counts.subset(moving))
