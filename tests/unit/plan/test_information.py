"""The information of a motion against closed forms and published designs."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import pytest

from gyrorig_solver.estimate import NoiseModel, Series, white_noise_information
from gyrorig_solver.estimate.information import motion_information
from gyrorig_solver.estimate.noise.noise_model import Sampling
from gyrorig_solver.numerics import ArrowheadMatrix
from gyrorig_solver.reference.reference_motion import EvaluatedMotion

N = np.radians(0.03)  # rad/s/sqrt(Hz)
HZ, SECONDS = 100.0, 75.0
SPEED, PAN = np.radians(54.0), np.radians(120.0)
TILT_MOVE_S = 0.639


@dataclass(frozen=True, eq=False)
class KnownMotion:
    """Pan and tilt on straight lines between times, known exactly."""

    time_s: np.ndarray
    pan: np.ndarray
    tilt: np.ndarray
    description: str = "straight lines"
    common_shift_std_s: float = 0.0
    is_differentiated: bool = False

    @property
    def information(self) -> ArrowheadMatrix:
        return ArrowheadMatrix.zero(0, 0)

    @property
    def prior_offset(self) -> np.ndarray:
        return np.zeros(0)

    def evaluate(self, edges_s: np.ndarray, derivatives: bool = True) -> EvaluatedMotion:
        pan, tilt = (np.interp(edges_s, self.time_s, a) for a in (self.pan, self.tilt))
        width = np.diff(edges_s)
        middle = (tilt[1:] + tilt[:-1]) / 2.0
        speed = np.diff(pan) / width
        rate = np.column_stack(
            [np.diff(tilt) / width, speed * np.sin(middle), speed * np.cos(middle)]
        )
        return EvaluatedMotion(rate, (), np.zeros((0, width.size, 3)))

    def with_step(self, step: np.ndarray) -> Self:
        return self


def sweeps_at_plus_and_minus(tilt_rad: float) -> KnownMotion:
    """Twenty-four pan sweeps in four blocks at +T and -T; T is reached in five moves of tilt."""
    time_s, pan, tilt = [0.0, 5.0], [-PAN / 2.0] * 2, [0.0] * 2

    def go(seconds: float, to_pan: float, to_tilt: float) -> None:
        time_s.append(time_s[-1] + seconds)
        pan.append(to_pan)
        tilt.append(to_tilt)

    for sign in (1.0, -1.0, 1.0, -1.0):
        go(TILT_MOVE_S, pan[-1], sign * tilt_rad)
        for _ in range(6):
            go(PAN / SPEED, -pan[-1], tilt[-1])
    go(TILT_MOVE_S, pan[-1], 0.0)
    go(SECONDS - time_s[-1], pan[-1], tilt[-1])
    return KnownMotion(np.array(time_s), np.array(pan), np.array(tilt))


def series() -> Series:
    count = int(SECONDS * HZ)
    time_s = np.asarray((np.arange(count) + 0.5) / HZ, dtype=np.float64)
    zero, good = np.zeros((count, 3)), np.ones(count, dtype=np.bool_)
    return Series(
        time_s, zero, good, samples_per_block=1, intervals_per_sample=5, bandwidth_hz=None
    )


def by_closed_form(tilt_rad: float) -> np.ndarray:
    """Standard deviations of the columns and of the bias: N / sqrt(2 integral of rate^2)."""
    pan_square = SPEED**2 * 24 * PAN / SPEED
    tilt_square = (2 * 1.0 + 3 * 4.0) * tilt_rad**2 / TILT_MOVE_S
    squares = [
        tilt_square,
        pan_square * np.sin(tilt_rad) ** 2,
        pan_square * np.cos(tilt_rad) ** 2,
        SECONDS,
    ]
    return np.asarray(N / np.sqrt(2.0 * np.array(squares)))


# Pan sweeps at +T and -T, by an independent calculation: ppm of columns x, y, z.
TABLE = {2.0: (2264.0, 1529.0, 53.0), 10.0: (453.0, 307.0, 54.0), 30.0: (151.0, 107.0, 62.0)}


@pytest.mark.parametrize("tilt_deg", list(TABLE))
def test_sweeps_at_plus_and_minus(tilt_deg: float) -> None:
    motion = sweeps_at_plus_and_minus(np.radians(tilt_deg))
    noise = NoiseModel(np.tile([N**2, 0.0, 0.0, 0.0], (3, 1)), Sampling(HZ, 1, None, 1e-9, False))
    information = motion_information(series(), motion, noise, np.eye(3))
    std = np.sqrt(np.diag(np.linalg.inv(information)))
    wanted = by_closed_form(np.radians(tilt_deg))
    for row in range(3):
        assert std[3 * row : 3 * row + 3] == pytest.approx(wanted[:3], rel=0.05)
        assert std[3 * row : 3 * row + 3] * 1e6 == pytest.approx(TABLE[tilt_deg], rel=0.05)
    assert std[9:12] == pytest.approx(wanted[3], rel=0.05)
    assert np.degrees(std[9]) == pytest.approx(0.0024, rel=0.05)


def test_pan_at_one_tilt_shows_nine_of_twelve() -> None:
    time_s = np.linspace(0.0, SECONDS, 76)
    motion = KnownMotion(
        time_s, PAN / 2.0 * np.cos(np.pi * np.arange(76)), np.full(76, np.radians(20.0))
    )
    rate = motion.evaluate(np.linspace(0.0, SECONDS, 3751)).rate_rad_s
    values = np.linalg.eigvalsh(white_noise_information(rate, 0.02, np.full(3, N**2))[:12, :12])
    # One column, tilt's, is not excited at all; of pan's two only one combination is.
    assert np.sum(values > 1e-6 * values[-1]) == 6


def test_quick_look_agrees_where_the_noise_is_white() -> None:
    motion = sweeps_at_plus_and_minus(np.radians(30.0))
    rate = motion.evaluate(np.linspace(0.0, SECONDS, 3751)).rate_rad_s
    quick = white_noise_information(rate, SECONDS / 3750, np.full(3, N**2))
    std = np.sqrt(np.diag(np.linalg.inv(quick)))
    wanted = by_closed_form(np.radians(30.0))
    assert std[:3] == pytest.approx(wanted[:3], rel=0.05)
    assert std[9] == pytest.approx(wanted[3], rel=0.05)


def test_what_is_loose_costs_what_a_fit_of_it_costs() -> None:
    """One unknown that mimics the pan column: its variance adds to the column's own."""
    rate = np.zeros((4000, 3))
    rate[:, 2] = np.sin(np.arange(4000) * 0.01)
    alone = white_noise_information(rate, 0.01, np.full(3, N**2))
    loose = 1e-3 * rate[None, :, :]
    with_it = white_noise_information(rate, 0.01, np.full(3, N**2), loose)
    assert alone[8, 8] > 0.0
    assert 1.0 / with_it[8, 8] == pytest.approx(1.0 / alone[8, 8] + 1e-6, rel=1e-6)
