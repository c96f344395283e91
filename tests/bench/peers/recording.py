"""What every method is given: the same samples, and the same knowledge of the unit.

Two kinds of knowledge. `known`: the unit's angles are given exactly, so that only the
estimators differ. `answers`: a recording as it is, orders and answered counts; each peer then
makes its own reference of the counts, as its users do.
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
HEAD_S = 0.5  # of answers before the first sample
TABLE_HZ = 1000.0  # of the exact angles, where they are given
# Low-pass of both sides before the counts are differentiated: a step over 20 ms is 2.6 deg/s.
SMOOTH_S = 0.05

# Pan at tilts of both signs, which shows all twelve; and what the paper's authors did.
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
    """What a peer works on: both sides' rates at the samples, and where they may be used."""

    time_s: FloatArray  # (n,)
    rate_hz: float
    raw_rad_s: FloatArray  # (n, 3), the samples themselves
    measured_rad_s: FloatArray  # (n, 3), smoothed as the reference was, where it had to be
    stage_rad_s: FloatArray  # (n, 3), the reference's body rate
    static: BoolArray  # (n,), the rest that a bias is taken from
    use: BoolArray  # (n,), False where the reference is lost
    pan_rad: FloatArray  # (n,), zero where there is no pan-tilt unit
    tilt_rad: FloatArray  # (n,)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """One run, and the truth of it."""

    board: Board
    session: Session
    counts: Counts
    known: bool  # the unit's angles are given
    table: Table

    @property
    def samples(self) -> GyroSamples:
        """As the solver has them after reading."""
        return samples_of(self.board, self.counts)

    def reference(self) -> ReferenceMotion:
        """What our solver is given; made of orders and answers where angles are not known."""
        if self.known:
            return ExactReference(self.session.path)
        return answered_reference(self.session)

    @property
    def truth(self) -> FloatArray:
        """G row by row, the mean bias, and the lag with the low-pass' delay, shape (13,)."""
        bias = self.counts.bias_rad_s.mean(axis=0)
        return np.concatenate([self.board.gain.ravel(), bias, [self.board.delay_s]])


def record(program: str, seed: int, rate_hz: float, bandwidth_hz: float, known: bool) -> Recording:
    """Return one simulated run of a program, its first 75 s.

    Args:
        program: its text.
        seed: boards, noise and unit of one seed are the same for both kinds of knowledge.
        rate_hz: of the samples.
        bandwidth_hz: of the sensor's low-pass.
        known: whether the unit's angles are given, or its answers only.
    """
    rng = np.random.default_rng([seed, 20261121])
    session = carry_out(parse_program(program, "program"), BAUD, rng)
    board = draw_board(rate_hz, bandwidth_hz, rng)
    end_s = min(HEAD_S + SECONDS, session.end_s - HEAD_S)
    counts = sample(board, session.path, (HEAD_S, end_s), rng)
    table = (_exact if known else _polled)(session, counts, rate_hz)
    return Recording(board, session, counts, known, table)


def _exact(session: Session, counts: Counts, rate_hz: float) -> Table:
    """Give the angles and rates at the samples as they were."""
    path, time_s, half_s = session.path, counts.time_s, 0.5 / TABLE_HZ
    angle = [path.angle_rad(axis, time_s) for axis in (0, 1)]
    after, before = (
        np.array([path.angle_rad(axis, time_s + shift_s) for axis in (0, 1)])
        for shift_s in (half_s, -half_s)
    )
    rate = (after - before) * TABLE_HZ
    stage = _stage(angle[1], rate[0], rate[1])
    return _table(session, counts, rate_hz, counts.rate_rad_s, stage, angle)


def _polled(session: Session, counts: Counts, rate_hz: float) -> Table:
    """Interpolate the counts, each at the middle of its exchange, and smooth both sides alike."""
    answers = session.answers
    middle_s = (answers.lo_s + answers.hi_s) / 2.0
    width = SMOOTH_S * rate_hz
    angle = []
    for axis in (0, 1):
        is_axis = answers.axis == axis
        steps = np.interp(counts.time_s, middle_s[is_axis], answers.steps[is_axis])
        angle.append(np.asarray(steps * RAD_PER_STEP, dtype=np.float64))
    rate = [gaussian_filter1d(angles, width, order=1) * rate_hz for angles in angle]
    stage = _stage(gaussian_filter1d(angle[1], width), rate[0], rate[1])
    measured = gaussian_filter1d(counts.rate_rad_s, width, axis=0)
    return _table(session, counts, rate_hz, measured, stage, angle)


def _table(
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


def _stage(tilt_rad: FloatArray, pan_rate: FloatArray, tilt_rate: FloatArray) -> FloatArray:
    """R = Rz(pan) Rx(tilt): (tilt', pan' sin tilt, pan' cos tilt)."""
    return np.column_stack([tilt_rate, pan_rate * np.sin(tilt_rad), pan_rate * np.cos(tilt_rad)])


def bound(recording: Recording, columns: tuple[int, ...] = (0, 1, 2)) -> FloatArray:
    """Return the least standard deviations of G, bias and lag, shape (13,).

    The Cramer-Rao bound with the unit's motion known and the noise that was drawn; entries of
    columns of G that are left out are nan.
    """
    board, counts = recording.board, recording.counts
    begin_s, n = float(counts.time_s[0]), counts.time_s.size
    rate = seen(board, recording.session.path, begin_s, n)
    slope = seen(board, recording.session.path, begin_s, n, slope=True)
    shown = [3 * row + column for row in range(3) for column in columns] + [9, 10, 11, TAU]
    information = np.zeros((13, 13))
    for row in range(3):
        design = np.column_stack([rate[:, columns], np.ones(n), -slope @ board.gain[row]])
        cover = Covariance(board.levels[row], board.bandwidth_hz, board.rate_hz, n)
        at = [*(3 * row + column for column in columns), 9 + row, TAU]
        information[np.ix_(at, at)] += design.T @ cover.weigh(design)
    inner = information[np.ix_(shown, shown)]
    unit = 1.0 / np.sqrt(np.diag(inner))
    variance = np.diag(np.linalg.inv(inner * np.outer(unit, unit))) * unit**2
    std = np.full(13, np.nan)
    std[shown] = np.sqrt(variance)
    return std


def groups(values: FloatArray) -> list[FloatArray]:
    """Return the entries of each of `GROUPS`, from the order of `Recording.truth`."""
    gain = values[:9].reshape(3, 3)
    return [*gain.T, values[9:12], values[12:]]
