"""Simulate a session for imucal: six rests and three full turns with exact angles.

What to use when: `session` for the data, `Imucal` and `fit_known_turns` (ours) for the two fits.
imucal cannot use a recording of a pan-tilt unit. It needs an accelerometer and a board that the
user turns by hand about each axis. The bench therefore compares it with ours on such a session.
"""

from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from tests.bench.accuracy.board import Board, Counts, draw_board
from tests.bench.accuracy.given import samples_of
from tests.bench.accuracy.noise import Covariance, low_pass, wander
from tests.bench.accuracy.profile import FloatArray

from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import fit_turns
from gyrorig_solver.reference import TimeInterval, TurnReference
from gyrorig_solver.reference.known_turns import KnownTurn

OURS, IMUCAL = "gyrorig, known turns", "imucal, Ferraris"
SECONDS = 75.0
REST_S, TURN_S, RAMP_S, PAUSE_S = 6.0, 10.0, 1.0, 1.0
HOLD_S = 0.5  # rest at both ends of the section of a turn
ANGLE_RAD = -2.0 * np.pi  # the sign that imucal uses
GRAVITY_M_S2 = 9.81  # the value that imucal uses
ACCEL_NOISE_M_S2 = 0.02
HAND_STD_RAD = 1e-3  # for our fit; it weights the turns equally and does not change the result
RESTS = ("x_p", "x_a", "y_p", "y_a", "z_p", "z_a")


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """One session and its true parameters."""

    board: Board
    counts: Counts
    accel_m_s2: FloatArray  # (n, 3)
    true_rad_s: FloatArray  # (n, 3), body rate
    sections: dict[str, slice]

    @property
    def truth(self) -> FloatArray:
        """The rows of G and the mean bias, shape (12,)."""
        return np.concatenate([self.board.gain.ravel(), self.counts.bias_rad_s.mean(axis=0)])

    @property
    def samples(self) -> GyroSamples:
        """The samples that our solver reads."""
        return samples_of(self.board, self.counts)

    @property
    def reference(self) -> TurnReference:
        """The reference of our solver, with the same sections."""

        def interval(name: str) -> TimeInterval:
            part, time_s = self.sections[name], self.counts.time_s
            return TimeInterval(float(time_s[part.start]), float(time_s[part.stop - 1]))

        turns = tuple(
            KnownTurn(interval(f"{axis}_rot"), np.eye(3)[k], ANGLE_RAD, HAND_STD_RAD)
            for k, axis in enumerate("xyz")
        )
        return TurnReference(turns, tuple(interval(name) for name in RESTS))


def session(seed: int, rate_hz: float, bandwidth_hz: float) -> Session:
    """Return one session of 75 s: rests of 6 s, then turns of 10 s, 1 s in between."""
    rng = np.random.default_rng([seed, 20261122])
    board = draw_board(rate_hz, bandwidth_hz, rng)
    n = round(SECONDS * rate_hz)
    time_s = np.arange(n) / rate_hz
    rate, up, sections, section_s = np.zeros((n, 3)), np.zeros((n, 3)), {}, PAUSE_S
    for name in (*RESTS, "x_rot", "y_rot", "z_rot"):
        axis, turning = "xyz".index(name[0]), name.endswith("rot")
        length_s = TURN_S if turning else REST_S
        part = slice(round(section_s * rate_hz), round((section_s + length_s) * rate_hz))
        sections[name] = part
        up[part, axis] = -1.0 if name.endswith("_a") else 1.0
        if turning:
            since_s = np.arange(part.stop - part.start) / rate_hz - HOLD_S
            left_s = length_s - 2.0 * HOLD_S - since_s
            shape = np.clip(np.minimum(since_s, left_s) / RAMP_S, 0.0, 1.0)
            rate[part, axis] = ANGLE_RAD * shape / (shape.sum() / rate_hz)
        section_s += length_s + PAUSE_S
    filtered = _filter_rate(rate, low_pass(_frequencies_hz(n, rate_hz), bandwidth_hz))
    bias = board.bias_rad_s + np.stack(
        [wander(level, n, rate_hz, rng) for level in board.levels], axis=1
    )
    clean = filtered @ board.gain.T
    white = np.stack([_draw_white_noise(board, k, n, rng) for k in range(3)], axis=1)
    accel = GRAVITY_M_S2 * up + rng.normal(scale=ACCEL_NOISE_M_S2, size=(n, 3))
    counts = Counts(time_s, clean + bias + white, clean, bias)
    return Session(board, counts, accel, filtered, sections)


def compute_bound(session: Session) -> FloatArray:
    """Return the Cramer-Rao bound of G and bias for known rates, shape (12,)."""
    design = np.column_stack([session.true_rad_s, np.ones(session.counts.time_s.size)])
    std = np.zeros(12)
    for row in range(3):
        cover = Covariance(
            session.board.levels[row],
            session.board.bandwidth_hz,
            session.board.rate_hz,
            len(design),
        )
        information = design.T @ cover.weigh(design)
        std[[3 * row, 3 * row + 1, 3 * row + 2, 9 + row]] = np.sqrt(
            np.diag(np.linalg.inv(information))
        )
    return std


def imucal_installed() -> bool:
    """Return whether imucal and pandas are installed."""
    return find_spec("imucal") is not None and find_spec("pandas") is not None


class Imucal:
    """The imucal fit of one session; the sections are cut before the timed part."""

    def __init__(self, session: Session) -> None:
        imucal, pandas = import_module("imucal"), import_module("pandas")
        columns = np.column_stack([session.accel_m_s2, np.degrees(session.counts.rate_rad_s)])
        names = [f"{kind}_{axis}" for kind in ("acc", "gyr") for axis in "xyz"]
        frame = pandas.DataFrame(columns, columns=names)
        sections = {k: {"start": s.start, "end": s.stop} for k, s in session.sections.items()}
        self._regions = imucal.ferraris_regions_from_section_list(
            frame, pandas.DataFrame(sections).T
        )
        self._method = imucal.FerrarisCalibration(grav=GRAVITY_M_S2, expected_angle=-360)
        self._rate_hz = session.board.rate_hz

    def compute(self) -> FloatArray:
        """Return gain and bias; the model of imucal is measured = K R true + K_ga acc + b."""
        calibration = self._method.compute(
            self._regions, self._rate_hz, from_acc_unit="m/s^2", from_gyr_unit="deg/s"
        )
        gain = np.asarray(calibration.K_g @ calibration.R_g, np.float64)
        return np.concatenate([gain.ravel(), np.radians(calibration.b_g)])


def fit_known_turns(samples: GyroSamples, reference: TurnReference) -> FloatArray:
    """Return the gain and the bias of our fit."""
    fit = fit_turns([(samples, reference)])
    return np.concatenate([fit.gain.ravel(), fit.bias_rad_s])


def _frequencies_hz(count: int, rate_hz: float) -> FloatArray:
    return np.asarray(rfftfreq(next_fast_len(2 * count, real=True), 1.0 / rate_hz))


def _filter_rate(values: FloatArray, response: NDArray[np.complex128]) -> FloatArray:
    ring = next_fast_len(2 * len(values), real=True)
    passed = irfft(rfft(values, ring, axis=0) * response[:, None], ring, axis=0)
    return np.asarray(passed[: len(values)], dtype=np.float64)


def _draw_white_noise(board: Board, axis: int, count: int, rng: np.random.Generator) -> FloatArray:
    """Draw noise with the spectral density of the bound, which includes the quantization noise."""
    cover = Covariance(board.levels[axis], board.bandwidth_hz, board.rate_hz, count)
    density = cover.white_density(_frequencies_hz(count, board.rate_hz))
    raw = rng.normal(size=(next_fast_len(2 * count, real=True), 1))
    ring = len(raw)
    shaped = irfft(rfft(raw[:, 0]) * np.sqrt(density * board.rate_hz / 2.0), ring)
    return np.asarray(shaped[:count], dtype=np.float64)
