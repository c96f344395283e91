"""One recording of one board, read in the same way for measurement and simulation.

A comparison is fair only if the same code processes both sides: the same clock mapping, the same
start times from the position replies, the same block means.

What to use when: `ObservedSession.of` for a recording; `check_has_unit` before a simulation;
`AXES` for the order of pan and tilt.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.estimate import Sampling, Series, build_series
from gyrorig_solver.estimate.series import too_short_error
from gyrorig_solver.reference import PanTiltReference, read_pan_tilt_reference

AXES = ("pan", "tilt")


@dataclass(frozen=True, slots=True, eq=False)
class AxisMoves:
    """The moves of one axis, from the position replies."""

    command_s: FloatArray  # (m,), time of each command
    start_s: FloatArray  # (m,)
    end_s: FloatArray  # (m,)
    direction: FloatArray  # (m,), 1 or -1
    start_std_s: FloatArray  # (m,), of the start time, from the position replies


@dataclass(frozen=True, eq=False)
class ObservedSession:
    """Samples, motion and block means of one board in one recording."""

    recording: Recording
    samples: GyroSamples
    reference: PanTiltReference
    series: Series  # the longest
    sampling: Sampling
    moves: tuple[AxisMoves, AxisMoves]  # pan and tilt

    @classmethod
    def of(cls, recording: Recording, board: str) -> Self:
        """Read one board of a recording.

        Raises:
            InputError: the recording has no pan-tilt unit, too few samples, or positions that
                the orders do not explain.
        """
        check_has_unit(recording)
        samples = load_samples(recording, board)
        reference = read_pan_tilt_reference(recording, samples.origin_ns)
        if not isinstance(reference, PanTiltReference):
            raise InputError(
                f"the positions in {recording.path.name} do not follow the recorded orders, so no "
                "simulation can replay them",
                "check with `gyrorig check` what the recording contains",
            )
        series, sampling = build_series(samples, reference.common_shift_std_s)
        if not series:
            raise too_short_error(sampling)
        longest = max(series, key=lambda segment: segment.time_s.size)
        return cls(recording, samples, reference, longest, sampling, _read_moves(reference))

    @property
    def block_count(self) -> int:
        """Number of block means."""
        return self.series.block_count

    @cached_property
    def time_s(self) -> FloatArray:
        """Time of each sample of the block means, shape (n * samples_per_block,)."""
        return self.series.time_s[: self.block_count * self.series.samples_per_block]

    @cached_property
    def block_time_s(self) -> FloatArray:
        """Middle of each block, shape (n,)."""
        return self.series.block_times_s()

    @cached_property
    def used_samples(self) -> BoolArray:
        """Samples that are present, neither saturated nor repeated."""
        return self.series.good[: self.time_s.size]

    @cached_property
    def used(self) -> BoolArray:
        """Blocks with a used sample, shape (n,)."""
        return self.series.used_blocks(self.used_samples)

    @property
    def block_samples(self) -> BoolArray:
        """Used samples of each block, shape (n, samples_per_block)."""
        return self.used_samples.reshape(self.block_count, -1)

    @cached_property
    def rate_rad_s(self) -> FloatArray:
        """Measured block means, shape (n, 3)."""
        rates = self.series.rate_rad_s(slice(0, self.time_s.size))
        return self.block_means(rates)

    @property
    def duration_s(self) -> float:
        """Duration of the block means."""
        return self.block_count / self.sampling.rate_hz

    def block_means(self, values: FloatArray) -> FloatArray:
        """Return block means of values at the samples, shape (n, k)."""
        return self.series.block_means(values, self.used_samples)

    @cached_property
    def stage_rate_rad_s(self) -> FloatArray:
        """Stage rate in each block from orders and position replies, shape (n, 3); 0 if unknown."""
        edges = self.series.block_edges_s(slice(0, self.block_count), 1)
        return np.nan_to_num(self.reference.evaluate(edges, derivatives=False).rate_rad_s)

    @cached_property
    def angle_rad(self) -> FloatArray:
        """Pan and tilt in the middle of each block, shape (2, n)."""
        return self.reference.angles_rad(self.block_time_s)

    @cached_property
    def first_sequence(self) -> int:
        """The board's number of the sample with index 0."""
        columns = self.recording.imu_columns(BoardId(self.samples.board))
        return int(columns.sequence[0]) - int(self.samples.number[0])

    def sample_numbers(self) -> IntArray:
        """Return the board's numbers of the samples, shape (m,)."""
        return np.asarray(self.first_sequence + self.samples.number.astype(np.int64))


def check_has_unit(recording: Recording) -> None:
    """Check that a simulation can replay the commands of a recording.

    Raises:
        InputError: the recording has no pan-tilt unit.
    """
    if not recording.ptu_positions().size:
        raise InputError(
            f"the recording {recording.path.name} has no pan-tilt unit, so no simulation can "
            "replay its orders",
            "check a recording of a pan-tilt unit",
        )


def _read_moves(unit_motion: PanTiltReference) -> tuple[AxisMoves, AxisMoves]:
    """Return the moves of both axes."""
    table = unit_motion.move_fit.table
    fitted = unit_motion.move_fit.parameters
    first = table.first_command[:-1]
    information = unit_motion.information
    precision = information.local.diagonal()[: table.command_count]
    start_std_s = 1.0 / np.sqrt(np.maximum(precision, 1e-12))
    ends_s = np.array([profile.end_s for _, profile in unit_motion.profiles])
    moves = []
    for axis in (0, 1):
        rows = np.flatnonzero(table.axis == axis)
        order = rows[np.argsort(fitted.start_times_s[first[rows]], kind="stable")]
        moves.append(
            AxisMoves(
                table.command_times_s[first[order]],
                fitted.start_times_s[first[order]],
                ends_s[order],
                np.sign(table.to_steps[order] - table.from_steps[order])
                * np.sign(unit_motion.rad_per_step[axis]),
                start_std_s[first[order]],
            )
        )
    return moves[0], moves[1]
