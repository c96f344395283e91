"""Causes of an axis, compared with independent computations."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.spatial.transform import Rotation
from tests.support.quick_cases import quick_cases

from gyrorig_daemon.emulator.causes.backlash import Backlash
from gyrorig_daemon.emulator.causes.base_compliance import BaseCompliance
from gyrorig_daemon.emulator.causes.earth_rotation import EARTH_RATE_RAD_S, earth_rate_base_rad_s
from gyrorig_daemon.emulator.causes.lost_steps import LostSteps, RotorShift
from gyrorig_daemon.emulator.causes.ringing import Ringing
from gyrorig_daemon.emulator.causes.tilt_zero import TiltZero
from gyrorig_daemon.emulator.physics.effects.harmonic import Harmonic
from gyrorig_daemon.emulator.physics.motion_law import MotionLaw
from gyrorig_daemon.emulator.physics.stage_motion import Stage
from gyrorig_daemon.emulator.physics.stepper_axis import AxisTruth, StepperAxis

ARCSEC = 185.142857
LAW = MotionLaw(58.0, 1200.0, 3900.0)
FINE_S = 1e-4

Moves = list[tuple[float, float]]
TO_AND_FRO: Moves = [(0.5, 900.0), (2.2, 400.0), (3.0, 800.0), (3.4, -300.0), (5.5, -500.0)]
END_S = 7.0


def driven(truth: AxisTruth, moves: Moves = TO_AND_FRO, law: MotionLaw = LAW) -> StepperAxis:
    """An axis that has got its commands, some of them while it still turns."""
    axis = StepperAxis(truth, law)
    for time_s, target in moves:
        axis.move(time_s, target)
    return axis


def fine_steps(axis: StepperAxis) -> np.ndarray:
    """The angle over all the time, in steps."""
    count = round(END_S / FINE_S) + 1
    return axis.angles_rad(0.0, FINE_S, count) / axis.truth.step_rad


def naive_play(steps: np.ndarray, gap: float) -> np.ndarray:
    """The operator sample by sample, as its definition says."""
    out, passed = steps[0], np.empty_like(steps)
    for k, x in enumerate(steps):
        out = min(max(out, x - gap), x)
        passed[k] = out
    return passed


def moving_average(steps: np.ndarray, window_s: float) -> np.ndarray:
    """The mean over the window before each sample, by trapezoids."""
    width = round(window_s / FINE_S)
    padded = np.concatenate([np.full(width, steps[0]), steps])
    sums = np.concatenate([[0.0], np.cumsum(0.5 * (padded[1:] + padded[:-1]))])
    return np.asarray((sums[width:] - sums[:-width]) / width)


def test_a_gap_is_lost_once_at_each_reversal_and_not_at_a_restart() -> None:
    gap = 1.7
    axis = driven(AxisTruth(ARCSEC, step_effects=(Backlash(gap),)))
    expected = naive_play(fine_steps(driven(AxisTruth(ARCSEC))), gap)
    # sample by sample the turning point itself is missed, by the base speed times a sample
    assert fine_steps(axis) == pytest.approx(expected, abs=58.0 * FINE_S)

    def rest(time_s: float) -> float:
        return float(axis.angles_rad(time_s, 1.0, 1)[0]) / axis.truth.step_rad

    assert rest(0.0) == 0.0
    assert rest(2.1) == pytest.approx(900.0 - gap)  # up: the wheel lags
    assert rest(2.95) == pytest.approx(400.0)  # down again: on the other flank
    assert rest(5.4) == pytest.approx(-300.0)
    assert rest(6.9) == pytest.approx(-500.0)  # further down: nothing is lost


@settings(max_examples=25, deadline=None)
@given(
    starts=st.lists(st.floats(0.0, END_S - 0.1), min_size=1, max_size=8),
    gap=st.floats(0.0, 30.0),
)
def test_a_gap_does_not_depend_on_who_asks_when(starts: list[float], gap: float) -> None:
    window = 64
    asked = driven(AxisTruth(ARCSEC, step_effects=(Backlash(gap),)))
    for start_s in starts:
        fresh = driven(AxisTruth(ARCSEC, step_effects=(Backlash(gap),)))
        whole = fresh.angles_rad(0.0, start_s / 999, 1000)[-1]
        row = asked.angles_rad(start_s, 1e-3, window)
        assert row[0] == pytest.approx(whole, abs=1e-12)


def test_a_gap_forgets_what_a_command_has_changed() -> None:
    axis = StepperAxis(AxisTruth(ARCSEC, step_effects=(Backlash(3.0),)), LAW)
    axis.move(0.0, 2000.0)
    axis.angles_rad(0.0, 1e-3, 4000)  # looks beyond the halt that comes
    axis.halt(0.5)
    axis.move(2.0, -100.0)
    again = StepperAxis(AxisTruth(ARCSEC, step_effects=(Backlash(3.0),)), LAW)
    again.move(0.0, 2000.0)
    again.halt(0.5)
    again.move(2.0, -100.0)
    assert (axis.angles_rad(0.0, 1e-3, 4000) == again.angles_rad(0.0, 1e-3, 4000)).all()


def test_nothing_rings_behind_a_gap_before_the_first_command() -> None:
    """A board asks for its motion from before the power-up of the unit."""
    effects = (Ringing(0.1, 8.0, 0.05),)
    truth = AxisTruth(ARCSEC, step_effects=(Backlash(3.0),), angle_effects=effects)
    assert (driven(truth).angles_rad(-1.0, 1e-3, 1000) == 0.0).all()


def test_an_s_curve_is_the_mean_of_the_plan_and_the_count_goes_with_it() -> None:
    window_s = 0.08
    axis = driven(AxisTruth(ARCSEC, s_curve_s=window_s))
    expected = moving_average(fine_steps(driven(AxisTruth(ARCSEC))), window_s)
    assert fine_steps(axis) == pytest.approx(expected, abs=2e-3)
    at = 3.37
    assert axis.state(at)[0] == pytest.approx(fine_steps(axis)[round(at / FINE_S)], abs=1e-9)
    assert axis.state(at)[1] == pytest.approx(
        np.diff(fine_steps(axis))[round(at / FINE_S)] / FINE_S, abs=1.0
    )
    assert axis.rests_at_s() == pytest.approx(
        driven(AxisTruth(ARCSEC)).rests_at_s() + window_s, abs=1e-12
    )


def test_an_s_curve_survives_homing() -> None:
    axis = StepperAxis(AxisTruth(ARCSEC, s_curve_s=0.1), LAW)
    axis.move(0.0, 500.0)
    rest_s = axis.rests_at_s()
    axis.recount(rest_s, 0.0)
    assert [axis.count(rest_s + t) for t in (0.0, 0.05, 0.2)] == [0, 0, 0]
    angles = axis.angles_rad(rest_s - 0.05, 1e-3, 300) / axis.truth.step_rad
    assert angles == pytest.approx(500.0, abs=2.0)
    assert angles[60:] == pytest.approx(500.0, abs=1e-9)


def test_a_gap_behind_an_s_curve() -> None:
    gap, window_s = 6.0, 0.08
    axis = driven(AxisTruth(ARCSEC, s_curve_s=window_s, step_effects=(Backlash(gap),)))
    smooth = fine_steps(driven(AxisTruth(ARCSEC, s_curve_s=window_s)))
    whole = axis.angles_rad(0.0, FINE_S, len(smooth)) / axis.truth.step_rad
    assert whole == pytest.approx(naive_play(smooth, gap), abs=1e-4)
    blocks = [axis.angles_rad(k * 0.05, FINE_S, 500) for k in range(140)]
    assert np.concatenate(blocks) / axis.truth.step_rad == pytest.approx(whole[:-1], abs=1e-9)


@pytest.mark.parametrize("window_s", quick_cases([0.0, 0.05], [0.05]))
def test_ringing_solves_its_equation(window_s: float) -> None:
    share, frequency_hz, damping = 0.1, 9.0, 0.05
    mode = Ringing(share, frequency_hz, damping)
    axis = driven(AxisTruth(ARCSEC, s_curve_s=window_s, angle_effects=(mode,)))
    x = fine_steps(driven(AxisTruth(ARCSEC, s_curve_s=window_s)))
    w = 2 * math.pi * frequency_hz
    system = ([-1.0, 0.0, 0.0], [1.0, 2 * damping * w, w * w])
    time_s: np.ndarray = FINE_S * np.arange(len(x), dtype=np.float64)
    _, q, _ = signal.lsim(system, x, time_s)
    added = fine_steps(axis) - x
    assert np.abs(added).max() > 0.2
    # lsim takes the input as straight lines: a jump of speed may lie anywhere in a sample
    assert added == pytest.approx(share * q, abs=2 * 58.0 * FINE_S * share)
    row = axis.angles_rad(3.3, FINE_S, 100) / axis.truth.step_rad
    assert row == pytest.approx(fine_steps(axis)[33000:33100], abs=1e-9)


@pytest.mark.parametrize("gap", quick_cases([1.7, 12.0], [12.0]))
def test_the_load_behind_a_gap_rings_when_it_begins_to_move(gap: float) -> None:
    share, frequency_hz, damping = 0.1, 9.0, 0.05
    w = 2 * math.pi * frequency_hz

    def geared(*modes: Ringing) -> StepperAxis:
        return driven(AxisTruth(ARCSEC, step_effects=(Backlash(gap),), angle_effects=modes))

    x = fine_steps(geared())
    axis = geared(Ringing(share, frequency_hz, damping))
    system = ([-1.0, 0.0, 0.0], [1.0, 2 * damping * w, w * w])
    _, q, _ = signal.lsim(system, x, FINE_S * np.arange(len(x), dtype=np.float64))
    added = fine_steps(axis) - x
    # A straight line has the jump of the speed, here up to 300 steps/s, anywhere in a sample.
    assert added == pytest.approx(share * q, abs=2 * 300.0 * FINE_S * share)
    motor = fine_steps(driven(AxisTruth(ARCSEC)))
    _, of_motor, _ = signal.lsim(system, motor, FINE_S * np.arange(len(x), dtype=np.float64))
    assert np.abs(share * (of_motor - q)).max() > 0.1 * share * np.abs(q).max()
    row = axis.angles_rad(3.3, FINE_S, 100) / axis.truth.step_rad
    assert row == pytest.approx(fine_steps(axis)[33000:33100], abs=1e-9)


def test_a_load_behind_a_gap_forgets_what_a_command_has_changed() -> None:
    def axis_after(looks_ahead: bool) -> np.ndarray:
        effects = (Ringing(0.1, 9.0, 0.05),)
        truth = AxisTruth(ARCSEC, step_effects=(Backlash(30.0),), angle_effects=effects)
        axis = driven(truth, [(0.0, 2000.0)])
        if looks_ahead:
            axis.angles_rad(0.0, 1e-3, 4000)
        axis.halt(0.05)
        axis.move(0.06, -100.0)
        return axis.angles_rad(0.0, 1e-3, 4000)

    assert axis_after(True) == pytest.approx(axis_after(False), abs=1e-15)


def test_a_base_twists_when_the_load_behind_a_gap_begins_to_move() -> None:
    c, gap, fine_s = 5e-5, 12.0, 1e-5
    moves: Moves = [(0.0, 300.0), (1.5, 0.0)]
    ramp_s = (math.sqrt(58.0**2 + 2 * 3900.0 * gap) - 58.0) / 3900.0  # until the gap is crossed
    plain, twisted = (
        driven(AxisTruth(ARCSEC, step_effects=(Backlash(gap),), angle_effects=effects), moves)
        for effects in ((), (BaseCompliance(c),))
    )
    count = round((ramp_s + 0.01) / fine_s)
    twist = twisted.angles_rad(1.5, fine_s, count) - plain.angles_rad(1.5, fine_s, count)
    twist /= plain.truth.step_rad
    engaged = round(ramp_s / fine_s)
    assert twist[: engaged - 1] == pytest.approx(0.0, abs=1e-9)
    # the impulse of the twist is -c times the change of the speed, here downwards
    assert twist.sum() * fine_s == pytest.approx(c * (58.0 + 3900.0 * (ramp_s + 0.01)), rel=0.05)


def test_ringing_dies_out_with_its_damping() -> None:
    mode = Ringing(0.1, 10.0, 0.05)
    axis = driven(AxisTruth(ARCSEC, angle_effects=(mode,)), [(0.0, 600.0)])
    rest_s = axis.rests_at_s()
    added = axis.angles_rad(rest_s, 0.1 / math.sqrt(1 - 0.05**2), 6) / axis.truth.step_rad - 600.0
    ratio = added[1:] / added[:-1]  # one period of the damped mode
    assert ratio == pytest.approx(math.exp(-2 * math.pi * 0.05 / math.sqrt(1 - 0.05**2)), rel=1e-6)


def test_compliance_twists_in_proportion_to_the_acceleration() -> None:
    c = 5e-5
    axis = driven(AxisTruth(ARCSEC, angle_effects=(BaseCompliance(c),)), [(0.5, 900.0)])
    plain = driven(AxisTruth(ARCSEC), [(0.5, 900.0)])
    twist = fine_steps(axis) - fine_steps(plain)
    ramp_s = (1200.0 - 58.0) / 3900.0
    inside = slice(round(0.51 / FINE_S), round((0.49 + ramp_s) / FINE_S))
    assert twist[inside] == pytest.approx(-c * 3900.0, rel=1e-6)
    cruising = round((0.51 + ramp_s) / FINE_S)
    assert twist[cruising : cruising + 100] == pytest.approx(0.0, abs=1e-8)
    # what it turns one way at an edge it turns back: the angle at rest is the plain one
    assert twist[-1] == pytest.approx(0.0, abs=1e-8)
    # the impulse of the twist over a move is -c times the change of speed, none in the end
    assert twist.sum() * FINE_S == pytest.approx(0.0, abs=c * 60.0)


def test_a_gear_error_depends_on_the_angle_and_not_on_the_speed() -> None:
    worm = Harmonic(2e-4, 17.5, 0.7)
    errors = []
    for speed in (400.0, 1200.0):
        law = MotionLaw(58.0, speed, 3900.0)
        plain = driven(AxisTruth(ARCSEC), [(0.0, 1500.0)], law)
        axis = driven(AxisTruth(ARCSEC, angle_effects=(worm,)), [(0.0, 1500.0)], law)
        angle = plain.angles_rad(0.0, FINE_S, 40001)
        error = axis.angles_rad(0.0, FINE_S, 40001) - angle
        grid = np.linspace(0.05, 1.3, 500)
        errors.append(np.interp(grid, angle, error))
        assert error == pytest.approx(2e-4 * np.sin(17.5 * angle + 0.7), abs=1e-15)
    assert errors[0] == pytest.approx(errors[1], abs=1e-8)
    one_turn_of_the_worm = math.radians(360.0 / 17.5)
    periodic = np.interp(grid[grid < 0.8] + one_turn_of_the_worm, angle, error)
    assert periodic == pytest.approx(errors[1][grid < 0.8], abs=1e-8)


def test_an_offset_moves_every_angle() -> None:
    axis = driven(AxisTruth(ARCSEC, angle_effects=(TiltZero(0.01),)))
    plain = driven(AxisTruth(ARCSEC))
    assert axis.angles_rad(0.0, 0.01, 600) - plain.angles_rad(0.0, 0.01, 600) == pytest.approx(0.01)


def test_a_wrong_acceleration_and_base_speed_change_how_long_a_move_takes() -> None:
    way = 900.0

    def lasts_s(base: float, acceleration: float) -> float:
        ramp_s = (1200.0 - base) / acceleration
        return 2 * ramp_s + (way - ramp_s * (1200.0 + base)) / 1200.0

    for truth, expected in (
        (AxisTruth(ARCSEC), lasts_s(58.0, 3900.0)),
        (AxisTruth(ARCSEC, acceleration_error=0.1), lasts_s(58.0, 4290.0)),
        (AxisTruth(ARCSEC, base_speed_added_steps_s=100.0), lasts_s(158.0, 3900.0)),
    ):
        axis = driven(truth, [(0.0, way)])
        assert axis.rests_at_s() == pytest.approx(expected, abs=1e-12)
        assert axis.count(expected + 1e-6) == 900
        assert axis.angles_rad(2.0, 1.0, 1)[0] == pytest.approx(way * truth.step_rad, rel=1e-12)


def test_a_halt_with_a_wrong_acceleration_still_stops_on_a_step() -> None:
    axis = StepperAxis(AxisTruth(ARCSEC, acceleration_error=-0.2), LAW)
    axis.move(0.0, 3000.0)
    axis.halt(0.8)
    steps, speed = axis.state(axis.rests_at_s() + 1e-9)
    assert steps == pytest.approx(axis.target(), abs=1e-6)
    assert speed == 0.0


@pytest.mark.parametrize("lost", [8.0, -3.0])
def test_lost_steps_are_lost_once_and_not_counted(lost: float) -> None:
    axis = driven(AxisTruth(ARCSEC, slips=(LostSteps(lost, after_s=1.0),)))
    plain = driven(AxisTruth(ARCSEC))
    difference = fine_steps(axis) - fine_steps(plain)
    # the first move after 1 s goes down from 900 to 400: it stops short of its way
    assert set(np.round(difference, 6)) == {0.0, lost}
    happened_s = axis.truth.slips[0].happened_s
    assert happened_s is not None
    assert 2.2 < happened_s < 2.9
    assert (difference != 0.0).argmax() * FINE_S == pytest.approx(happened_s, abs=2 * FINE_S)
    assert [axis.count(t) for t in (2.1, 2.95, 6.9)] == [900, 400, -500]


def test_steps_can_be_lost_several_times() -> None:
    slips = (RotorShift(4.0, 2.5), LostSteps(8.0, 1.0), RotorShift(-4.0, 2.6))
    difference = fine_steps(driven(AxisTruth(ARCSEC, slips=slips))) - fine_steps(
        driven(AxisTruth(ARCSEC))
    )
    assert all(slip.happened_s is not None for slip in slips)
    assert set(np.round(difference, 6)) == {0.0, 8.0, 12.0}
    assert difference[-1] == pytest.approx(8.0)


def test_a_gap_swallows_lost_steps_that_fit_into_it() -> None:
    # The rotor falls back by 2 steps on its way up, the wheel stands still meanwhile.
    gap, lost = 5.0, 2.0
    axis = driven(
        AxisTruth(ARCSEC, slips=(LostSteps(lost, 0.0),), step_effects=(Backlash(gap),)),
        [(0.5, 900.0)],
    )
    (slip,) = axis.truth.slips
    assert slip.happened_s is not None
    around = axis.angles_rad(slip.happened_s - 2e-3, 1e-4, 41) / axis.truth.step_rad
    assert np.diff(around).min() >= 0.0
    assert axis.angles_rad(3.0, 1.0, 1)[0] / axis.truth.step_rad == pytest.approx(900 - lost - gap)


def test_the_ground_turns_under_the_stage() -> None:
    ground = earth_rate_base_rad_s(EARTH_RATE_RAD_S, math.radians(48.0), math.radians(30.0))
    assert np.linalg.norm(ground) == pytest.approx(EARTH_RATE_RAD_S)
    # Facing east, north is to the left; at the pole the whole of it is about the vertical.
    assert earth_rate_base_rad_s(1.0, 0.0, math.pi / 2) == pytest.approx([-1.0, 0.0, 0.0])
    assert earth_rate_base_rad_s(1.0, math.pi / 2, 0.3) == pytest.approx([0.0, 0.0, 1.0])
    error_rad = 0.02
    pan, tilt = driven(AxisTruth(ARCSEC)), driven(AxisTruth(ARCSEC), [(0.2, -400.0)])
    with_ground = Stage(pan, tilt, error_rad, ground_rate_rad_s=ground)
    motion = with_ground.motion(0.0, 1e-3, 5000)
    still = Stage(pan, tilt, error_rad).body_rates_rad_s(0.0, 1e-3, 5000)
    attitude = (
        Rotation.from_euler("z", motion.pan_rad[:, None])
        * Rotation.from_euler("y", error_rad)
        * Rotation.from_euler("x", motion.tilt_rad[:, None])
    )
    assert motion.body_rate_rad_s - still == pytest.approx(attitude.inv().apply(ground), abs=1e-15)
