"""Simulate the data of every method: the same samples and the same reference of the unit.

There are two kinds of reference. With `known`, every method gets the true angles of the unit, so
that only the estimators differ. Otherwise, a recording contains commands and position replies. The
peers then interpolate the replies, as their users do.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from tests.bench.accuracy.board import Board, Counts, draw_board, sample, seen
from tests.bench.accuracy.given import ExactReference, answered_reference, samples_of
from tests.bench.accuracy.noise import Covariance
from tests.bench.accuracy.profile import RAD_PER_STEP, FloatArray
from tests.bench.accuracy.unit import Session, carry_out

from gyrorig_protocol.program import parse_program
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.reference import ReferenceMotion

BoolArray = NDArray[np.bool_]
BAUD = 115_200.0
SECONDS = 75.0
HEAD_S = 0.5  # of replies before the first sample
TABLE_HZ = 1000.0  # for the differences of the true angles
# Low-pass of both sides before the differentiation: one step in 20 ms is 2.6 deg/s.
SMOOTH_S = 0.05

# Pan sweeps at tilts of both signs determine all twelve parameters; CROSS is the paper's cycle.
SWEEPS = """
schema: gyrorig/program/1
name: sweeps
description: pan at three tilts, both signs
settings: {base_speed_deg_s: 3.0, acceleration_deg_s2: 200.0, default_speed_deg_s: 60.0}
steps:
  - rest: {seconds: 7.0, phase: static}
  - repeat:
      times: 2
      steps:
        - move: {tilt_deg: 28.0, speed_deg_s: 40.0}
        - rest: {seconds: 0.6}
        - move: {pan_deg: 100.0}
        - rest: {seconds: 0.6}
        - move: {pan_deg: -100.0}
        - rest: {seconds: 0.6}
        - move: {tilt_deg: -40.0, speed_deg_s: 40.0}
        - rest: {seconds: 0.6}
        - move: {pan_deg: 100.0}
        - rest: {seconds: 0.6}
        - move: {pan_deg: -100.0}
        - rest: {seconds: 0.6}
        - move: {tilt_deg: 0.0, speed_deg_s: 40.0}
        - rest: {seconds: 0.6}
        - move: {pan_deg: 100.0}
        - rest: {seconds: 0.6}
        - move: {pan_deg: 0.0}
        - rest: {seconds: 0.6}
  - rest: {seconds: 10.0, phase: static}
"""
CROSS = """
schema: gyrorig/program/1
name: cross
description: the paper's cycle, pan out and back, then tilt out and back
settings: {base_speed_deg_s: 3.0, acceleration_deg_s2: 200.0, default_speed_deg_s: 30.0}
steps:
  - rest: {seconds: 7.0, phase: static}
  - repeat:
      times: 3
      steps:
        - move: {pan_deg: 60.0, speed_deg_s: 30.0}
        - rest: {seconds: 0.6}
        - move: {pan_deg: -60.0, speed_deg_s: 30.0}
        - rest: {seconds: 0.6}
        - move: {pan_deg: 0.0, speed_deg_s: 30.0}
        - rest: {seconds: 0.6}
        - move: {tilt_deg: 30.0, speed_deg_s: 20.0}
        - rest: {seconds: 0.6}
        - move: {tilt_deg: -30.0, speed_deg_s: 20.0}
        - rest: {seconds: 0.6}
        - move: {tilt_deg: 0.0, speed_deg_s: 20.0}
        - rest: {seconds: 0.6}
  - rest: {seconds: 10.0, phase: static}
"""
GROUPS = ("gain, x (tilt)", "gain, y (roll)", "gain, z (pan)", "bias", "time offset")
TAU = 12


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The data of a peer: measured and reference rates at the samples, and a mask."""

    time_s: FloatArray  # (n,)
    rate_hz: float
    raw_rad_s: FloatArray  # (n, 3), unfiltered samples
    measured_rad_s: FloatArray  # (n, 3), smoothed if the reference is smoothed
    stage_rad_s: FloatArray  # (n, 3), body rate of the reference
    static: BoolArray  # (n,), the rest from which a peer takes the bias
    use: BoolArray  # (n,), False if there is no reference
    pan_rad: FloatArray  # (n,), zero without a pan-tilt unit
    tilt_rad: FloatArray  # (n,)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """One run and its true parameters."""

    board: Board
    session: Session
    counts: Counts
    known: bool  # the methods get the true angles of the unit
    table: Table

    @property
    def samples(self) -> GyroSamples:
        """The samples that our solver reads."""
        return samples_of(self.board, self.counts)

    def reference(self) -> ReferenceMotion:
        """Return the reference of our solver: the true angles, or commands and replies."""
        if self.known:
            return ExactReference(self.session.path)
        return answered_reference(self.session)

    @property
    def truth(self) -> FloatArray:
        """The rows of G, the mean bias, and the delay with that of the low-pass, shape (13,)."""
        bias = self.counts.bias_rad_s.mean(axis=0)
        return np.concatenate([self.board.gain.ravel(), bias, [self.board.delay_s]])


def record(program: str, seed: int, rate_hz: float, bandwidth_hz: float, known: bool) -> Recording:
    """Simulate the first 75 s of a program.

    Args:
        program: the text of the program.
        seed: runs with the same seed have the same board, noise and unit.
        rate_hz: sample rate.
        bandwidth_hz: bandwidth of the low-pass of the sensor.
        known: whether the methods get the true angles, or only position replies.
    """
    rng = np.random.default_rng([seed, 20261121])
    session = carry_out(parse_program(program, "program"), BAUD, rng)
    board = draw_board(rate_hz, bandwidth_hz, rng)
    end_s = min(HEAD_S + SECONDS, session.end_s - HEAD_S)
    counts = sample(board, session.path, (HEAD_S, end_s), rng)
    table = (_make_exact_table if known else _make_polled_table)(session, counts, rate_hz)
    return Recording(board, session, counts, known, table)


def _make_exact_table(session: Session, counts: Counts, rate_hz: float) -> Table:
    """Return a table with the true angles and rates at the samples."""
    path, time_s, half_s = session.path, counts.time_s, 0.5 / TABLE_HZ
    angle = [path.angle_rad(axis, time_s) for axis in (0, 1)]
    after, before = (
        np.array([path.angle_rad(axis, time_s + shift_s) for axis in (0, 1)])
        for shift_s in (half_s, -half_s)
    )
    rate = (after - before) * TABLE_HZ
    stage = stage_rate_rad_s(angle[1], rate[0], rate[1])
    return _make_table(session, counts, rate_hz, counts.rate_rad_s, stage, angle)


def _make_polled_table(session: Session, counts: Counts, rate_hz: float) -> Table:
    """Interpolate the replies between the midpoints of their exchanges; smooth both sides."""
    replies = session.answers
    middle_s = (replies.lo_s + replies.hi_s) / 2.0
    width = SMOOTH_S * rate_hz
    angle = []
    for axis in (0, 1):
        is_axis = replies.axis == axis
        steps = np.interp(counts.time_s, middle_s[is_axis], replies.steps[is_axis])
        angle.append(np.asarray(steps * RAD_PER_STEP, dtype=np.float64))
    rate = [gaussian_filter1d(angles, width, order=1) * rate_hz for angles in angle]
    stage = stage_rate_rad_s(gaussian_filter1d(angle[1], width), rate[0], rate[1])
    measured = gaussian_filter1d(counts.rate_rad_s, width, axis=0)
    return _make_table(session, counts, rate_hz, measured, stage, angle)


def _make_table(
    session: Session,
    counts: Counts,
    rate_hz: float,
    measured_rad_s: FloatArray,
    stage_rad_s: FloatArray,
    angle_rad: list[FloatArray],
) -> Table:
    return Table(
        time_s=counts.time_s,
        rate_hz=rate_hz,
        raw_rad_s=counts.rate_rad_s,
        measured_rad_s=measured_rad_s,
        stage_rad_s=stage_rad_s,
        static=np.asarray(counts.time_s < session.path.moves[0].start_s - 0.1),
        use=np.ones(counts.time_s.size, dtype=np.bool_),
        pan_rad=angle_rad[0],
        tilt_rad=angle_rad[1],
    )


def stage_rate_rad_s(
    tilt_rad: FloatArray, pan_rate: FloatArray, tilt_rate: FloatArray
) -> FloatArray:
    """R = Rz(pan) Rx(tilt): (tilt', pan' sin tilt, pan' cos tilt)."""
    return np.column_stack([tilt_rate, pan_rate * np.sin(tilt_rad), pan_rate * np.cos(tilt_rad)])


def compute_bound(recording: Recording, columns: tuple[int, ...] = (0, 1, 2)) -> FloatArray:
    """Return the Cramer-Rao bound of G, bias and delay, shape (13,).

    The bound is for the true motion of the unit and the simulated noise levels. The entries of the
    other columns of G are NaN.
    """
    board, counts = recording.board, recording.counts
    begin_s, n = float(counts.time_s[0]), counts.time_s.size
    rate = seen(board, recording.session.path, begin_s, n)
    slope = seen(board, recording.session.path, begin_s, n, slope=True)
    estimated = [3 * row + column for row in range(3) for column in columns] + [9, 10, 11, TAU]
    information = np.zeros((13, 13))
    for row in range(3):
        design = np.column_stack([rate[:, columns], np.ones(n), -slope @ board.gain[row]])
        cover = Covariance(board.levels[row], board.bandwidth_hz, board.rate_hz, n)
        at = [*(3 * row + column for column in columns), 9 + row, TAU]
        information[np.ix_(at, at)] += design.T @ cover.weigh(design)
    inner = information[np.ix_(estimated, estimated)]
    unit = 1.0 / np.sqrt(np.diag(inner))
    variance = np.diag(np.linalg.inv(inner * np.outer(unit, unit))) * unit**2
    std = np.full(13, np.nan)
    std[estimated] = np.sqrt(variance)
    return std


def split_groups(values: FloatArray) -> list[FloatArray]:
    """Split values in the order of `Recording.truth` into the parameters of `GROUPS`."""
    gain = values[:9].reshape(3, 3)
    return [*gain.T, values[9:12], values[12:]]
