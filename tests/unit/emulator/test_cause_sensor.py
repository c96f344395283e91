"""Causes of a board, compared with independent computations."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate
from scipy.spatial.transform import Rotation

from gyrorig_daemon.emulator.causes.axis_swap import AxisSwap
from gyrorig_daemon.emulator.causes.bias_ramp import BiasRamp
from gyrorig_daemon.emulator.causes.bias_random_walk import BiasRandomWalk
from gyrorig_daemon.emulator.causes.bias_step import BiasStep
from gyrorig_daemon.emulator.causes.board_slip import BoardSlip
from gyrorig_daemon.emulator.causes.clock_skew import ClockSkew
from gyrorig_daemon.emulator.causes.clock_step import ClockStep
from gyrorig_daemon.emulator.causes.corrupt_samples import CorruptSamples
from gyrorig_daemon.emulator.causes.dead_zone import DeadZone
from gyrorig_daemon.emulator.causes.g_sensitivity import GSensitivity
from gyrorig_daemon.emulator.causes.lost_samples import LostSamples
from gyrorig_daemon.emulator.causes.motor_coupling import MotorCoupling
from gyrorig_daemon.emulator.causes.repeated_samples import RepeatedSamples
from gyrorig_daemon.emulator.causes.sample_jitter import SampleJitter
from gyrorig_daemon.emulator.causes.scale_asymmetry import ScaleAsymmetry
from gyrorig_daemon.emulator.causes.scale_cubic import ScaleCubic
from gyrorig_daemon.emulator.causes.scale_quadratic import ScaleQuadratic
from gyrorig_daemon.emulator.causes.sign_flip import SignFlip
from gyrorig_daemon.emulator.causes.supply_hum import SupplyHum
from gyrorig_daemon.emulator.causes.thermal_bias import ThermalBias
from gyrorig_daemon.emulator.causes.thermal_scale import ThermalScale
from gyrorig_daemon.emulator.causes.vibration_rectification import VibrationRectification
from gyrorig_daemon.emulator.causes.warm_up import WarmUp
from gyrorig_daemon.emulator.emulator_settings import BoardSettings
from gyrorig_daemon.emulator.physics.effects.rig_hooks import BoardHooks
from gyrorig_daemon.emulator.physics.imu import BLOCK_S, ImuModel, ImuTruth, SampleBlock
from gyrorig_daemon.emulator.physics.motion_law import MotionLaw
from gyrorig_daemon.emulator.physics.stage_motion import STANDARD_GRAVITY_M_S2, Stage
from gyrorig_daemon.emulator.physics.stepper_axis import AxisTruth, StepperAxis
from gyrorig_daemon.emulator.physics.temperature import BoardTemperature
from gyrorig_daemon.emulator.rig_truth import sample_board_truth

STEP_RAD = math.radians(185.142857 / 3600.0)
ODR_HZ = 100.0
END_S = 8.0
# at rest until 1 s; pan plateau 1.3 .. 3.0 s; rest; pan back at another speed and tilt at once
MOVES = (("pan", 1.0, 2000.0, 1000.0), ("tilt", 4.0, -600.0, 700.0), ("pan", 4.2, -500.0, 1200.0))
TRUTH = replace(
    sample_board_truth(BoardSettings(), np.random.default_rng(7)).imu.without_noise(),
    odr_hz=ODR_HZ,
    gyro_limit_rad_s=100.0,
    gyro_scale_rad_s=1e-4,
)


def stage() -> Stage:
    axes = {}
    for name in ("pan", "tilt"):
        axis = StepperAxis(AxisTruth(185.142857), MotionLaw(58.0, 1000.0, 3900.0))
        for which, time_s, target, speed in MOVES:
            if which == name:
                axis.move(time_s, target, MotionLaw(58.0, speed, 3900.0))
        axes[name] = axis
    return Stage(axes["pan"], axes["tilt"])


def run(hooks: BoardHooks | None = None, truth: ImuTruth = TRUTH) -> SampleBlock:
    """All samples of a session, as one block."""
    model = ImuModel(truth, stage(), 0.0, np.random.default_rng(1), hooks=hooks)
    blocks = [model.next_block() for _ in range(round(END_S / BLOCK_S))]
    return SampleBlock(
        first=0,
        time_s=np.concatenate([b.time_s for b in blocks]),
        gyro=np.vstack([b.gyro for b in blocks]),
        rate_rad_s=np.vstack([b.rate_rad_s for b in blocks]),
        accel=np.vstack([b.accel for b in blocks]),
        temperature_degc=np.concatenate([b.temperature_degc for b in blocks]),
        saturated=np.concatenate([b.saturated for b in blocks]),
        bias_rad_s=np.mean([b.bias_rad_s for b in blocks], axis=0),
    )


PLAIN = run()


def rows(*times_s: float) -> list[int]:
    return [int(np.argmin(np.abs(PLAIN.time_s - t))) for t in times_s]


def added(hooks: BoardHooks) -> np.ndarray:
    """What the hooks add to the rate, (n, 3)."""
    return run(hooks).rate_rad_s - PLAIN.rate_rad_s


def plateau_rad_s() -> np.ndarray:
    """The rate times gain where only pan turns, at 1000 steps/s and level."""
    return np.asarray(TRUTH.gain @ np.array([0.0, 0.0, 1000.0 * STEP_RAD]))


@pytest.mark.parametrize(("cause", "power"), [(ScaleQuadratic, 2), (ScaleCubic, 3)])
def test_a_nonlinear_scale_adds_a_power_of_the_rate(
    cause: type[ScaleQuadratic] | type[ScaleCubic], power: int
) -> None:
    coefficient = np.array([0.02, -0.03, 0.01])
    more = added(BoardHooks(rate_effects=[cause(coefficient)]))
    assert more[rows(2.0)[0]] == pytest.approx(coefficient * plateau_rad_s() ** power, rel=1e-6)
    assert more[rows(0.9)[0]] == pytest.approx(0.0, abs=1e-12)


def test_an_asymmetric_scale_adds_the_same_in_both_directions() -> None:
    share = np.array([0.0, 0.0, 3e-3])
    more = added(BoardHooks(rate_effects=[ScaleAsymmetry(share)]))[:, 2]
    rate = (PLAIN.rate_rad_s - TRUTH.bias_rad_s)[:, 2]
    up, back = rows(2.0, 5.0)
    assert rate[up] > 0.5
    assert rate[back] < -0.5
    assert more[[up, back]] == pytest.approx(3e-3 * np.abs(rate[[up, back]]), rel=1e-4)


def test_a_dead_zone_shows_small_rates_as_none() -> None:
    u = plateau_rad_s()
    width = 1.2 * np.array([abs(u[0]), 0.1 * abs(u[1]), 0.0])
    more = added(BoardHooks(rate_effects=[DeadZone(width)]))[rows(2.0)[0]]
    assert more == pytest.approx([-u[0], 0.0, 0.0], abs=1e-9)


def test_a_limit_cuts_flat_tops() -> None:
    limit = np.array([np.inf, np.inf, 0.6])
    cut = run(BoardHooks(limit_rad_s=limit))
    beyond = np.abs(PLAIN.rate_rad_s[:, 2]) > 0.6
    assert beyond.sum() > 100
    assert set(np.abs(cut.gyro[beyond, 2])) == {6000}
    assert (cut.gyro[~beyond] == PLAIN.gyro[~beyond]).all()
    assert (cut.gyro[:, :2] == PLAIN.gyro[:, :2]).all()


def test_gravity_moves_the_bias_with_the_tilt() -> None:
    matrix = np.array([[1e-4, 2e-4, -3e-4], [0.0, 5e-4, 0.0], [1e-4, 0.0, 1e-4]])
    more = added(BoardHooks(rate_effects=[GSensitivity(matrix)]))
    for time_s, tilt_rad in ((0.9, 0.0), (7.9, -600.0 * STEP_RAD)):
        felt = STANDARD_GRAVITY_M_S2 * np.array([0.0, math.sin(tilt_rad), math.cos(tilt_rad)])
        expected = matrix @ (TRUTH.mounting @ felt)
        assert more[rows(time_s)[0]] == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_vibration_and_motor_current_show_on_axes_that_do_not_turn() -> None:
    v, m = np.array([1e-3, -2e-3, 5e-4]), np.array([2e-4, 0.0, -1e-4])
    shaken = added(BoardHooks(rate_effects=[VibrationRectification(v)]))
    driven = added(BoardHooks(rate_effects=[MotorCoupling(m)]))
    on, off, both = rows(2.0, 3.8, 4.75)
    speeds = 1000.0 * STEP_RAD
    assert shaken[on] == pytest.approx(v * speeds**2, rel=1e-6)
    assert driven[[on, both]] == pytest.approx(np.array([m, m]), rel=1e-3)
    for more in (shaken, driven):
        assert more[off] == pytest.approx(0.0, abs=1e-9)
    pan, tilt = 1200.0 * STEP_RAD, 700.0 * STEP_RAD
    assert shaken[both] == pytest.approx(v * (pan**2 + tilt**2), rel=1e-4)


def test_the_gain_moves_with_the_temperature() -> None:
    share = np.array([0.0, 0.0, 5e-3])
    more = added(BoardHooks(rate_effects=[ThermalScale(share)]))
    at = rows(2.0)[0]
    rise = PLAIN.temperature_degc[at] - TRUTH.ambient_degc
    assert more[at, 2] == pytest.approx(5e-3 * rise * plateau_rad_s()[2], rel=5e-3)


@pytest.mark.parametrize(("lag_s", "warm_s", "soak_k"), [(25, 80, 0), (15, 200, 20), (80, 80, -8)])
def test_the_die_follows_the_board_with_a_first_order_lag(
    lag_s: float, warm_s: float, soak_k: float
) -> None:
    board = BoardTemperature(22.0, 3.0, warm_s, 0.0, soak_k, (30.0, 150.0))
    time_s = np.linspace(0.0, 300.0, 61)

    def slope(t: float, rise: np.ndarray) -> np.ndarray:
        expected = (
            3.0 * (1 - math.exp(-t / warm_s))
            + soak_k * (1 - math.cos(2 * math.pi * max(t - 30.0, 0.0) / 120)) / 2
        )
        return np.asarray((expected - rise) / lag_s)

    solved = integrate.solve_ivp(slope, (0, 300), [0.0], t_eval=time_s, rtol=1e-9, atol=1e-9)
    assert board.rise_k(time_s, lag_s) == pytest.approx(solved.y[0], abs=2e-5)
    assert board.rise_k(time_s) == pytest.approx(board.degc(time_s) - 22.0, abs=1e-12)
    k = np.array([1e-3, 0.0, -2e-3])
    effect = ThermalBias(k, lag_s)
    assert effect.added_rad_s(time_s, board) == pytest.approx(np.outer(solved.y[0], k), abs=1e-7)


def test_biases_that_move_by_the_clock() -> None:
    vector = np.array([1e-3, -2e-3, 3e-3])
    t = PLAIN.time_s
    for effect, shape in (
        (WarmUp(vector, 40.0), np.exp(-t / 40.0)),
        (BiasRamp(vector), t),
        (BiasStep(vector, 3.0), (t >= 3.0) * 1.0),
        (SupplyHum(vector, 49.98, 0.4), np.sin(2 * np.pi * 49.98 * t + 0.4)),
    ):
        more = added(BoardHooks(bias_effects=[effect]))
        assert more == pytest.approx(np.outer(shape, vector), abs=1e-12)


def test_a_random_walk_has_its_variance_and_one_path() -> None:
    board = BoardTemperature(20.0, 0.0, 1.0, 0.0)
    ends = []
    for seed in range(300):
        walk = BiasRandomWalk(np.array([1e-4, 2e-4, 0.0]), np.random.default_rng(seed))
        ends.append(walk.added_rad_s(np.array([25.0]), board)[0])
    spread = np.std(ends, axis=0)
    assert spread[:2] == pytest.approx([5e-4, 1e-3], rel=0.15)  # 4 sigma of 300 draws
    assert spread[2] == 0.0
    again = BiasRandomWalk(np.array([1e-4, 2e-4, 0.0]), np.random.default_rng(299))
    path = again.added_rad_s(np.linspace(0.0, 500.0, 5001), board)
    assert path[250] == pytest.approx(ends[-1], abs=1e-15)
    assert path[0] == pytest.approx(0.0)


def test_a_lag_shows_the_motion_of_an_earlier_time() -> None:
    late = run(truth=replace(TRUTH, tau_s=TRUTH.tau_s + 0.02)).rate_rad_s
    stepped = run(BoardHooks(lags=[ClockStep(0.02, 3.0)])).rate_rad_s
    before = PLAIN.time_s < 2.95
    assert (stepped[before] == PLAIN.rate_rad_s[before]).all()
    assert stepped[PLAIN.time_s > 3.5] == pytest.approx(late[PLAIN.time_s > 3.5], abs=1e-9)
    back = run(BoardHooks(lags=[ClockStep(-0.02, 3.0)])).rate_rad_s
    assert back[before] == pytest.approx(late[before], abs=1e-9)
    assert back[PLAIN.time_s > 3.5] == pytest.approx(PLAIN.rate_rad_s[PLAIN.time_s > 3.5], abs=1e-9)


def test_a_skew_is_a_lag_that_grows_with_time() -> None:
    growth = 2e-3
    skewed = run(BoardHooks(lags=[ClockSkew(growth, 0.0)])).rate_rad_s
    for time_s in (1.1, 3.15, 4.1, 4.3):
        lag_s = growth * time_s
        late = run(truth=replace(TRUTH, tau_s=TRUTH.tau_s + lag_s)).rate_rad_s
        near = np.abs(PLAIN.time_s - time_s) < 0.02
        moved = np.abs(late - PLAIN.rate_rad_s)[near].max()
        assert moved > 5e-3  # there is an edge here
        assert skewed[near] == pytest.approx(late[near], abs=0.03 * moved)
    shrinking = ClockSkew(-1e-3, 5e-3)
    assert np.array(shrinking.at(2.0)) == pytest.approx([3e-3, -1e-3])
    assert shrinking.at(9.0) == (0.0, 0.0)  # never of the future


def test_jitter_takes_each_sample_somewhat_earlier() -> None:
    hooks = BoardHooks(jitter=SampleJitter(1.5e-3, np.random.default_rng(3)))
    jittered = run(hooks).rate_rad_s
    drawn = SampleJitter(1.5e-3, np.random.default_rng(3))
    late_s = np.concatenate([drawn.draw_s(8) for _ in range(len(jittered) // 8)])
    assert late_s.std() == pytest.approx(1.5e-3, rel=0.05)
    # the same sensor, read at 8 kHz: what it shows at the right instant
    fine = run(truth=replace(TRUTH, odr_hz=8000.0))
    for axis in range(3):
        shown = np.interp(PLAIN.time_s - late_s, fine.time_s, fine.rate_rad_s[:, axis])
        assert jittered[8:, axis] == pytest.approx(shown[8:], abs=5e-6)
    assert np.abs(jittered - PLAIN.rate_rad_s).max() > 5e-3


def test_stale_words_are_exactly_those_of_the_sample_before() -> None:
    hooks = BoardHooks(count_effects=[RepeatedSamples(0.1, np.random.default_rng(5))])
    read = run(hooks).gyro
    changed = (read != PLAIN.gyro).any(axis=1)
    assert 0.02 < changed.mean() < 0.16
    for k in np.flatnonzero(changed):
        assert (read[k] == read[k - 1]).all()
    moving = (np.diff(PLAIN.gyro, axis=0) != 0).any(axis=1)
    repeated = moving & (np.diff(read, axis=0) == 0).all(axis=1)
    assert repeated.sum() == pytest.approx(0.1 * moving.sum(), rel=0.4)


def test_corrupt_words_have_one_wrong_bit_or_an_old_high_byte() -> None:
    hooks = BoardHooks(count_effects=[CorruptSamples(0.2, 0.5, np.random.default_rng(6))])
    read, true = run(hooks).gyro, PLAIN.gyro
    wrong = np.argwhere(read != true)
    assert len(wrong) > 40
    assert (np.unique(wrong[:, 0], return_counts=True)[1] == 1).all()  # one word of a sample
    flips = torn = 0
    for k, axis in wrong:
        bits = bin(int(read[k, axis] & 0xFFFF) ^ int(true[k, axis] & 0xFFFF)).count("1")
        low, high = read[k, axis] & 0xFF, read[k, axis] & 0xFF00
        old = low == true[k, axis] & 0xFF and high == true[k - 1, axis] & 0xFF00
        assert bits == 1 or old
        flips, torn = flips + (not old), torn + (old and bits != 1)
    assert flips > 30
    assert torn > 0
    assert np.abs(read).max() <= 32768


@pytest.mark.parametrize("step_s", [0.02, -0.02])
@pytest.mark.parametrize("at_s", [1.043, 1.12, 4.2149])
def test_a_clock_jumps_between_two_samples(step_s: float, at_s: float) -> None:
    """The low-pass has followed the motion until the jump, at any sample of a block."""
    jumping = run(BoardHooks(lags=[ClockStep(step_s, at_s)]))
    late, early = max(step_s, 0.0), max(-step_s, 0.0)  # the lag after the jump and before it
    after = run(truth=replace(TRUTH, tau_s=TRUTH.tau_s + late)).rate_rad_s
    before = run(truth=replace(TRUTH, tau_s=TRUTH.tau_s + early)).rate_rad_s
    expected = np.where((jumping.time_s >= at_s)[:, None], after, before)
    assert np.abs(after - before).max() > 0.05
    assert np.abs(jumping.rate_rad_s - expected).max() < 1e-6


def test_words_are_drawn_once_also_when_a_block_is_computed_again() -> None:
    moving = stage()
    rng = np.random.default_rng(9)
    hooks = BoardHooks(count_effects=[CorruptSamples(0.3, 0.5, rng), RepeatedSamples(0.3, rng)])
    model = ImuModel(TRUTH, moving, 0.0, np.random.default_rng(1), hooks=hooks)
    for _ in range(30):
        model.next_block()
    before = model.next_block()
    moving.pan.move(float(before.time_s[-1]) + 1.0, 0.0)  # changes nothing in this block
    again = model.recompute_if_moved()
    assert again is not None
    assert (again.gyro == before.gyro).all()


def test_rewired_axes_and_another_full_scale() -> None:
    swapped = run(BoardHooks(count_effects=[AxisSwap(1, 2)])).gyro
    assert (swapped == PLAIN.gyro[:, [0, 2, 1]]).all()
    flipped = run(BoardHooks(count_effects=[SignFlip(1)])).gyro
    assert (flipped == PLAIN.gyro * [1, -1, 1]).all()
    wider = run(BoardHooks(count_factor=0.5)).gyro
    assert np.abs(wider - 0.5 * PLAIN.gyro).max() <= 0.75  # rounding of both


def test_a_slipped_board_sees_everything_turned() -> None:
    turn = Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix()
    slipped = run(BoardHooks(mount_effects=[BoardSlip(turn, 3.5)]))
    before = PLAIN.time_s < 3.45
    assert slipped.rate_rad_s[before] == pytest.approx(PLAIN.rate_rad_s[before], abs=1e-12)
    at = rows(5.0)[0]
    moved = replace(
        TRUTH,
        mounting=turn @ TRUTH.mounting,
        gain=TRUTH.gain @ TRUTH.mounting.T @ turn @ TRUTH.mounting,
    )
    other = run(truth=moved)
    assert slipped.rate_rad_s[at] == pytest.approx(other.rate_rad_s[at], abs=1e-9)
    assert (slipped.accel[at:] == other.accel[at:]).all()


def test_lost_samples_come_in_short_gaps_at_their_share() -> None:
    lost = LostSamples(0.02, 3, np.random.default_rng(2))
    drawn = np.concatenate([lost.draw(8) for _ in range(5000)])
    assert drawn.mean() == pytest.approx(0.02, rel=0.15)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], drawn, [False]]).astype(int)))
    lengths = edges[1::2] - edges[::2]
    assert set(lengths) >= {1, 2, 3}
    assert lengths.max() <= 8  # two gaps may touch
