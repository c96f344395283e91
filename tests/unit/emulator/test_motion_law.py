"""The stepper's motion law against closed forms and its own invariants."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrorig_daemon.emulator.physics.motion_law import MotionLaw, Segment, halt_target, plan_motion
from gyrorig_daemon.emulator.physics.stepper_axis import AxisTruth, StepperAxis

LAW = MotionLaw(base_speed_steps_s=100.0, speed_steps_s=1000.0, acceleration_steps_s2=2000.0)

laws = st.builds(
    MotionLaw,
    base_speed_steps_s=st.integers(0, 2000).map(float),
    speed_steps_s=st.integers(1, 3000).map(float),
    acceleration_steps_s2=st.integers(100, 20000).map(float),
)


def at(segments: list[Segment], time_s: float) -> tuple[float, float]:
    current = [s for s in segments if s.start_s <= time_s][-1]
    return current.at(time_s)


def test_long_move_is_the_trapezoid_of_the_manual() -> None:
    # Ramp 100 -> 1000 at 2000 steps/s^2: 0.45 s and (1000^2 - 100^2) / 4000 = 247.5 steps.
    segments = plan_motion(0.0, 0.0, 0.0, 3000.0, LAW)
    assert [s.acceleration_steps_s2 for s in segments] == [2000.0, 0.0, -2000.0, 0.0]
    assert segments[1].start_s == pytest.approx(0.45, abs=1e-12)
    assert segments[1].steps == pytest.approx(247.5, abs=1e-9)
    cruise_s = (3000.0 - 2 * 247.5) / 1000.0
    assert segments[2].start_s == pytest.approx(0.45 + cruise_s, abs=1e-12)
    assert segments[3].start_s == pytest.approx(0.9 + cruise_s, abs=1e-12)
    assert at(segments, 99.0) == (3000.0, 0.0)


def test_short_move_is_a_triangle() -> None:
    segments = plan_motion(0.0, 0.0, 0.0, 100.0, LAW)
    # vp^2 = a D + vb^2 = 200000 + 10000, and each ramp lasts (vp - vb) / a.
    peak = math.sqrt(210000.0)
    assert segments[1].speed_steps_s == pytest.approx(peak, abs=1e-9)
    assert segments[-1].start_s == pytest.approx(2 * (peak - 100.0) / 2000.0, abs=1e-12)


def test_below_base_speed_there_is_no_ramp() -> None:
    law = MotionLaw(1000.0, 500.0, 2000.0)
    segments = plan_motion(1.0, 0.0, 0.0, -250.0, law)
    assert segments == [Segment(1.0, 0.0, -500.0, 0.0), Segment(1.5, -250.0, 0.0, 0.0)]


def test_reversal_brakes_through_base_speed_then_comes_back() -> None:
    segments = plan_motion(0.0, 0.0, 1000.0, -500.0, LAW)
    assert segments[0] == Segment(0.0, 0.0, 1000.0, -2000.0)
    assert at(segments, 0.45)[0] == pytest.approx(247.5)
    assert segments[1].speed_steps_s == -100.0
    assert at(segments, 99.0) == (-500.0, 0.0)


def test_target_too_near_is_overshot() -> None:
    segments = plan_motion(0.0, 0.0, 1000.0, 100.0, LAW)
    assert max(at(segments, 0.001 * k)[0] for k in range(2000)) == pytest.approx(247.5, abs=0.1)
    assert at(segments, 99.0) == (100.0, 0.0)


@given(
    law=laws,
    steps=st.integers(-3000, 3000),
    target=st.integers(-3000, 3000),
    part=st.floats(-1.0, 1.0),
)
def test_position_is_continuous_and_speed_within_the_law(
    law: MotionLaw, steps: int, target: int, part: float
) -> None:
    fastest = max(law.speed_steps_s, law.base_speed_steps_s)
    segments = plan_motion(0.0, float(steps), part * fastest, float(target), law)
    for before, after in itertools.pairwise(segments):
        assert after.start_s >= before.start_s
        end, speed = before.at(after.start_s)
        assert end == pytest.approx(after.steps, abs=1e-5)
        jump = abs(after.speed_steps_s - speed)
        # Only between -base and +base, or down to a wanted speed below it, is a jump allowed.
        assert jump < 1e-6 or max(abs(speed), abs(after.speed_steps_s)) <= (
            law.base_speed_steps_s + 1e-6
        )
    assert segments[-1].steps == target
    assert segments[-1].speed_steps_s == 0.0


@given(
    law=laws, steps=st.integers(-3000, 3000), target=st.integers(-3000, 3000), part=st.floats(0, 1)
)
def test_the_same_plan_from_any_instant_ends_at_the_same_time(
    law: MotionLaw, steps: int, target: int, part: float
) -> None:
    first = plan_motion(0.0, float(steps), 0.0, float(target), law)
    end_s = first[-1].start_s
    now_s = part * end_s
    again = plan_motion(now_s, *at(first, now_s), float(target), law)
    assert again[-1].start_s == pytest.approx(end_s, abs=1e-5)


@given(law=laws, steps=st.floats(-3000, 3000), part=st.floats(-1.0, 1.0))
def test_a_halt_rests_on_a_whole_step_within_one_of_the_stopping_distance(
    law: MotionLaw, steps: float, part: float
) -> None:
    speed = part * max(law.speed_steps_s, law.base_speed_steps_s)
    target = halt_target(steps, speed, law)
    assert target == round(target)
    stop = steps + math.copysign(law.stopping_steps(abs(speed)), speed)
    assert abs(target - stop) <= 1.0 + 1e-6


def axis(law: MotionLaw = LAW) -> StepperAxis:
    return StepperAxis(AxisTruth(resolution_arcsec=185.142857), law)


def test_count_is_the_steps_passed_in_either_direction() -> None:
    moved = axis(MotionLaw(1000.0, 100.0, 2000.0))
    moved.move(0.0, 10)
    assert [moved.count(0.001 * k) for k in (0, 9, 11, 99, 100, 150)] == [0, 0, 1, 9, 10, 10]
    moved.move(1.0, -10)
    assert [moved.count(1.0 + 0.001 * k) for k in (0, 9, 11, 199, 200)] == [10, 10, 9, -9, -10]


def test_speed_change_on_the_fly_keeps_the_target() -> None:
    moved = axis(MotionLaw(1000.0, 100.0, 2000.0))
    moved.move(0.0, 100)
    moved.set_law(0.5, MotionLaw(1000.0, 500.0, 2000.0))
    assert moved.state(0.5) == (50.0, 500.0)
    assert moved.rests_at_s() == pytest.approx(0.6)
    assert moved.target() == 100


@pytest.mark.parametrize("delay_s", [0.25, -0.125])
def test_the_motion_changes_a_delay_after_each_command(delay_s: float) -> None:
    commands = (("move", 1.0, 1500.0, LAW), ("halt", 2.0, 0.0, LAW))
    plain = axis()
    late = StepperAxis(AxisTruth(185.142857, start_delay_s=delay_s), LAW)
    for moved in (plain, late):
        moved.replay(commands)
    for time_s in (0.5, 1.1, 1.9, 2.1, 9.0):
        assert late.state(time_s + delay_s) == pytest.approx(plain.state(time_s))


def test_a_command_does_not_change_what_was() -> None:
    moved = axis()
    moved.move(0.0, 3000)
    before = moved.angles_rad(0.0, 1e-3, 500)
    moved.halt(0.5)
    assert (moved.angles_rad(0.0, 1e-3, 500) == before).all()
    # 247.5 steps to stop from 1000 steps/s, and then on to the next whole step.
    assert moved.state(99.0)[0] == math.ceil(moved.state(0.5)[0] + 247.5 - 1e-6)


def test_lost_steps_show_in_the_angle_and_not_in_the_count() -> None:
    moved = axis()
    moved.shift(1.0, 8.0)
    moved.move(2.0, 100)
    assert moved.count(9.0) == 100
    step = 185.142857 / 3600.0
    angles = moved.angles_rad(0.5, 8.5, 2)
    assert [math.degrees(a) for a in angles] == pytest.approx([0.0, 108.0 * step])


def test_homing_recounts_without_turning() -> None:
    moved = StepperAxis(AxisTruth(185.142857), LAW, true_steps=40.0)
    before = moved.angles_rad(0.0, 1.0, 1)
    moved.move(1.0, -40)
    moved.recount(5.0, 0.0)
    assert moved.count(6.0) == 0
    assert moved.angles_rad(6.0, 1.0, 1)[0] == pytest.approx(0.0)
    assert (moved.angles_rad(0.0, 1.0, 1) == before).all()
