"""The bench's own rig and bound against closed forms, dense algebra and each other."""

import numpy as np
import pytest
from scipy.stats import chi2
from tests.bench.accuracy.board import NAMES, draw_board, factor_slopes, factors, sample, seen
from tests.bench.accuracy.bound import bound
from tests.bench.accuracy.noise import Covariance, Levels
from tests.bench.accuracy.profile import RAD_PER_STEP, Path, Trapezoid
from tests.bench.accuracy.trial import PROGRAMS
from tests.bench.accuracy.unit import carry_out

from gyrorig_protocol.program import MotionProgram, parse_program
from gyrorig_solver.model import factorise

SHORT = """
schema: gyrorig/program/1
name: short
settings: {base_speed_deg_s: 3.0, acceleration_deg_s2: 200.0}
steps:
  - move: {tilt_deg: 25.0, speed_deg_s: 40.0}
  - move: {pan_deg: 60.0, speed_deg_s: 70.0}
  - move: {tilt_deg: -35.0, speed_deg_s: 60.0}
  - move: {pan_deg: -40.0, speed_deg_s: 50.0}
  - move: {pan_deg: 0.0, tilt_deg: 0.0, pan_speed_deg_s: 60.0, tilt_speed_deg_s: 30.0}
"""


def short_program() -> MotionProgram:
    return parse_program(SHORT, "short")


def test_a_trapezoid_goes_its_way_at_its_speeds() -> None:
    for way, speed in ((2000, 1400.0), (100, 1400.0), (-700, 600.0), (300, 40.0)):
        move = Trapezoid(0, 1.0, 0, way, speed, 4000.0, 58.0)
        time_s = np.linspace(0.9, move.end_s + 0.1, 200_001)
        gone = move.gone_steps(time_s)
        assert gone[0] == 0.0
        assert gone[-1] == abs(way)
        slope = np.gradient(gone, time_s)
        # Two samples err at each jump to and from the base speed.
        off = np.abs(slope - np.abs(move.speed_at_steps_s(time_s))) > 1.0
        assert off.sum() <= 8
        # Its duration by the trapezoid rule of kinematics: way = integral of speed.
        covered = np.trapezoid(np.abs(move.speed_at_steps_s(time_s)), time_s)
        assert covered == pytest.approx(abs(way), rel=1e-3)


def test_a_ramp_is_seen_late_by_lag_and_low_pass() -> None:
    """In the middle of a ramp of the rate a low-pass lags by its group delay at 0."""
    rng = np.random.default_rng(1)
    board = draw_board(100.0, 25.0, rng)
    move = Trapezoid(0, 2.0, 0, 4000, 3000.0, 1000.0, 0.0)
    path = Path((move,), (np.zeros(2), np.zeros(1)))
    rate = seen(board, path, 0.5, 500)
    time_s = 0.5 + np.arange(500) / 100.0
    middle = (time_s > 3.0) & (time_s < 3.5)
    expected = 1000.0 * (time_s[middle] - 2.0 - board.delay_s) * RAD_PER_STEP
    assert np.allclose(rate[middle, 2], expected, atol=1e-6)
    slope = seen(board, path, 0.5, 500, slope=True)
    assert np.allclose(slope[middle, 2], 1000.0 * RAD_PER_STEP, atol=1e-4)


def test_factors_are_the_solvers() -> None:
    rng = np.random.default_rng(2)
    gain = draw_board(100.0, 25.0, rng).gain
    assert np.allclose(factors(gain), factorise(gain).as_vector(), atol=1e-12)
    change = rng.normal(scale=1e-5, size=(3, 3))
    linear = factor_slopes(gain) @ change.ravel()
    assert np.allclose(factors(gain + change) - factors(gain), linear, atol=1e-8)


def dense(cover: Covariance) -> np.ndarray:
    """The covariance sample by sample: numeric integrals of the densities, and K^2 min(s, t)."""
    n, rate = cover.size, cover.rate_hz
    f = (np.arange(20_000) + 0.5) * (rate / 2.0) / 20_000
    lag = np.arange(n) / rate
    density = cover.white_density(f)
    white = np.array([np.mean(density * np.cos(2 * np.pi * f * t)) for t in lag]) * rate / 2.0
    # Flicker has lines at the circle's own frequencies only.
    ring = 2 * n
    lines = np.arange(1, ring // 2 + 1) * rate / ring
    power = cover.levels.flicker**2 / (np.pi * lines) * rate / ring
    power[-1] /= 2.0
    flicker = np.array([np.sum(power * np.cos(2 * np.pi * lines * t)) for t in lag])
    gap = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    first = np.minimum.outer(np.arange(1, n + 1), np.arange(1, n + 1))
    slow = flicker[gap] + cover.levels.walk**2 / rate * first
    centre = np.eye(n) - 1.0 / n
    return np.asarray(white[gap] + centre @ slow @ centre)


def test_the_covariance_is_what_its_densities_say() -> None:
    cover = Covariance(Levels(5e-4, 5e-4, 3e-4, 1.5e-4), 25.0, 100.0, 384)
    full = dense(cover)
    columns = np.random.default_rng(3).normal(size=(384, 4))
    assert np.allclose(cover.times(columns), full @ columns, rtol=1e-4, atol=1e-9)
    inverse = np.linalg.solve(full, columns)
    assert np.allclose(cover.weigh(columns), inverse, rtol=1e-3, atol=1e-3 * np.abs(inverse).max())


@pytest.mark.parametrize("known", [True, False])
def test_the_bound_is_that_of_dense_algebra(known: bool) -> None:
    """With the profile known every entry is weighed densely; else the answers must only add."""
    rng = np.random.default_rng(4)
    session = carry_out(short_program(), 115_200.0, rng)
    board = draw_board(100.0, 25.0, rng)
    counts = sample(board, session.path, (0.5, session.end_s - 0.4), rng)
    cramer_rao = bound(board, session, counts, known)
    n, begin_s = counts.time_s.size, float(counts.time_s[0])
    rate = seen(board, session.path, begin_s, n)
    slope = seen(board, session.path, begin_s, n, slope=True)
    information = np.zeros((13, 13))
    for axis in range(3):
        columns = np.column_stack([rate, np.ones(n), -slope @ board.gain[axis]])
        at = [3 * axis, 3 * axis + 1, 3 * axis + 2, 9 + axis, 12]
        cover = Covariance(board.levels[axis], 25.0, 100.0, n)
        information[np.ix_(at, at)] += columns.T @ np.linalg.solve(dense(cover), columns)
    inverse = np.linalg.inv(information)
    turn = np.zeros((13, 13))
    turn[:3, 9:12], turn[3:12, :9], turn[12, 12] = np.eye(3), factor_slopes(board.gain), 1.0
    std = np.sqrt(np.diag(turn @ inverse @ turn.T))
    bound_std = np.sqrt(np.diag(cramer_rao.covariance))
    if known:
        assert np.allclose(bound_std, std, rtol=2e-3)
    else:
        assert np.all(bound_std > 0.995 * std)
        assert bound_std[NAMES.index("time_offset")] > 10.0 * std[NAMES.index("time_offset")]


def test_weighing_by_density_comes_near(monkeypatch: pytest.MonkeyPatch) -> None:
    """Long pieces by the density alone: the bound within 1 %, as for long recordings."""
    rng = np.random.default_rng(6)
    program = parse_program((PROGRAMS / "quick.yaml").read_text(encoding="utf-8"), "quick")
    session = carry_out(program, 115_200.0, rng)
    board = draw_board(100.0, 25.0, rng)
    counts = sample(board, session.path, (0.5, session.end_s - 0.4), rng)
    exact = np.diag(bound(board, session, counts, False).covariance)
    monkeypatch.setattr("tests.bench.accuracy.bound.EXACT_SAMPLES", 0)
    near = np.diag(bound(board, session, counts, False).covariance)
    assert np.allclose(near, exact, rtol=0.02)


@pytest.mark.long
@pytest.mark.parametrize("known", [True, False])
def test_the_best_estimate_errs_by_the_bound(known: bool) -> None:
    """Joint chi-squared of 13 over 24 runs of drawn noise: inside its 99.8 % span."""
    total = 0.0
    for seed in range(24):
        rng = np.random.default_rng([5, seed])
        session = carry_out(short_program(), 9600.0, rng)
        board = draw_board(100.0, 25.0, rng)
        counts = sample(board, session.path, (0.5, session.end_s - 0.4), rng)
        cramer_rao = bound(board, session, counts, known)
        total += float(cramer_rao.error @ np.linalg.solve(cramer_rao.covariance, cramer_rao.error))
    low, high = (float(chi2.ppf(share, 24 * 13)) for share in (0.001, 0.999))
    assert low < total < high
