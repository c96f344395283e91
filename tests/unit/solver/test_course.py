"""Courses against closed forms and their own invariants, moves against what was told."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gyrorig_solver.reference import MotionLimits, MotionProfile, plan_motion
from gyrorig_solver.reference.unit.motion_profile import CommandKind, ProfileCommand
from gyrorig_solver.reference.unit.profile_derivatives import differentiate_move
from gyrorig_solver.reference.unit.recorded_orders import UnitExchange, translate_exchanges
from gyrorig_solver.reference.unit.stage_kinematics import stage_rate
from gyrorig_solver.reference.unit.unit_moves import MotionReader, UnitMotion

USUAL = MotionLimits(speed_steps_s=1000.0, acceleration_steps_s2=2000.0, base_speed_steps_s=100.0)
limits = st.builds(
    MotionLimits,
    speed_steps_s=st.floats(31.0, 2900.0),
    acceleration_steps_s2=st.floats(200.0, 8000.0),
    base_speed_steps_s=st.floats(0.0, 1500.0),
)
orders = st.lists(
    st.tuples(
        st.floats(0.0, 2.0),  # s since the order before
        st.sampled_from(["to", "by", "keep", "stop"]),
        st.integers(-3000, 3000),
        limits,
    ),
    min_size=1,
    max_size=4,
)
CommandList = list[tuple[float, CommandKind, int, MotionLimits]]


def laid(commands: CommandList) -> MotionProfile:
    at, given_orders = 0.0, []
    base = commands[0][3].base_speed_steps_s  # a unit does not change it on the way
    for wait_s, kind, steps, own_limits in commands:
        at += wait_s
        law = MotionLimits(own_limits.speed_steps_s, own_limits.acceleration_steps_s2, base)
        given_orders.append(ProfileCommand(at, kind, float(steps), law))
    return plan_motion(0.0, given_orders)


def alone(distance: float, law: MotionLimits) -> MotionProfile:
    return plan_motion(0.0, [ProfileCommand(0.0, "to", distance, law)])


@given(distance=st.integers(1, 6000), law=limits)
def test_travel_and_speed_hold(distance: int, law: MotionLimits) -> None:
    course = alone(float(distance), law)
    t = np.linspace(0.0, course.end_s, 2001)
    x = course.position_steps(t)
    assert x[0] == 0.0
    assert x[-1] == pytest.approx(distance, rel=1e-9)
    assert np.all(np.diff(x) >= -1e-9)
    v = course.speed_steps_s(t[1:-1])
    assert v.max() <= max(law.speed_steps_s, 0.0) * (1.0 + 1e-9)
    # Symmetric: the second half is the first one backwards.
    assert np.allclose(x + x[::-1], distance, atol=1e-6 * distance + 1e-9)
    assert np.allclose(course.progress(t), x / distance, atol=1e-9)


def test_a_long_move_is_the_trapezoid_of_the_manual() -> None:
    """Ramp 100 to 1000 at 2000 steps/s^2: 0.45 s and (1000^2 - 100^2) / 4000 = 247.5 steps."""
    course = alone(3000.0, USUAL)
    assert course.acceleration_steps_s2.tolist() == [2000.0, 0.0, -2000.0, 0.0]
    cruise_s = (3000.0 - 2.0 * 247.5) / 1000.0
    assert course.start_s == pytest.approx([0.0, 0.45, 0.45 + cruise_s, 0.9 + cruise_s])
    assert course.start_steps == pytest.approx([0.0, 247.5, 2752.5, 3000.0])


def test_a_short_move_is_a_triangle() -> None:
    """Peak^2 = a D + base^2."""
    course = alone(-100.0, USUAL)
    peak = np.sqrt(2000.0 * 100.0 + 100.0**2)
    assert course.end_s == pytest.approx(2.0 * (peak - 100.0) / 2000.0)
    assert course.speed_steps_s(np.array([course.end_s / 2.0]))[0] == pytest.approx(-peak)


def test_below_base_speed_there_is_no_ramp() -> None:
    course = alone(300.0, MotionLimits(500.0, 2000.0, 1000.0))
    assert course.end_s == pytest.approx(0.6)
    assert course.acceleration_steps_s2.tolist() == [0.0, 0.0]


def test_a_reversal_brakes_through_base_speed_and_comes_back() -> None:
    course = plan_motion(
        0.0, [ProfileCommand(0.0, "to", 3000.0, USUAL), ProfileCommand(1.0, "to", -500.0, USUAL)]
    )
    # 247.5 steps of ramp and 0.55 s of cruise; then 0.45 s and 247.5 steps to brake.
    turn_s, turn = 1.45, 247.5 + 550.0 + 247.5
    assert course.position_steps(np.array([1.0, turn_s])) == pytest.approx([797.5, turn])
    back = alone(turn + 500.0, USUAL)
    assert course.end_s == pytest.approx(turn_s + back.end_s)
    t = np.linspace(0.0, back.end_s, 50)
    assert course.position_steps(turn_s + t) == pytest.approx(turn - back.position_steps(t))


def test_a_halt_brakes_to_rest() -> None:
    course = plan_motion(
        0.0, [ProfileCommand(0.0, "to", 3000.0, USUAL), ProfileCommand(1.0, "stop", 0.0, USUAL)]
    )
    assert course.start_steps[-1] == pytest.approx(797.5 + 247.5)
    assert course.end_s == pytest.approx(1.45)
    # The move to where it stopped is the same move: what makes a polled rest enough.
    same = alone(float(course.start_steps[-1]), USUAL)
    t = np.linspace(0.0, 2.0, 100)
    assert course.position_steps(t) == pytest.approx(same.position_steps(t), abs=1e-6)


@given(commands=orders)
def test_position_is_continuous_and_speed_within_the_law(commands: CommandList) -> None:
    course = laid(commands)
    base = commands[0][3].base_speed_steps_s
    length = np.diff(course.start_s)
    assert np.all(length >= 0.0)
    end_speed = course.start_speed_steps_s[:-1] + course.acceleration_steps_s2[:-1] * length
    end = course.start_steps[:-1] + 0.5 * (course.start_speed_steps_s[:-1] + end_speed) * length
    assert np.allclose(end, course.start_steps[1:], atol=1e-4)
    jump = np.abs(course.start_speed_steps_s[1:] - end_speed)
    slow = np.maximum(np.abs(course.start_speed_steps_s[1:]), np.abs(end_speed)) <= base + 1e-6
    assert np.all((jump < 1e-4) | slow)
    assert course.start_speed_steps_s[-1] == 0.0
    assert np.all(np.diff(course.distance_steps) >= 0.0)


def test_derivatives_of_several_commands_equal_differences() -> None:
    motion = read(exchanges_at([(0.0, "PS1000"), (1.0, "PP3000"), (2.2, "PS600"), (3.0, "PP-700")]))
    (move,) = motion.moves
    assert [o.kind for o in move.commands] == ["to", "keep", "to"]
    still = np.zeros(motion.speed_class_count)
    t = np.linspace(1.01, 8.0, 500)
    result = differentiate_move(move, move.start_times_s, still, 0.0, t)
    here = move.profile(move.start_times_s, still, 0.0).position_steps(t)
    assert result.starts.sum(axis=0) == pytest.approx(
        -move.profile(move.start_times_s, still, 0.0).speed_steps_s(t), abs=0.3
    )
    for k in range(3):
        later = move.start_times_s + 1e-3 * (np.arange(3) == k)
        change = move.profile(later, still, 0.0).position_steps(t) - here
        assert change == pytest.approx(1e-3 * result.starts[k], abs=0.01)


def test_stage_rate_is_the_derivative_of_the_attitude() -> None:
    def attitude(t: float) -> Rotation:
        return Rotation.from_euler("z", 0.4 * t + 0.2) * Rotation.from_euler("x", 0.7 * t * t - 0.3)

    t, h = 0.37, 1e-6
    numeric = (attitude(t - h).inv() * attitude(t + h)).as_rotvec() / (2.0 * h)
    result = stage_rate(np.array([0.7 * t * t - 0.3]), np.array([0.4]), np.array([1.4 * t]))
    assert np.allclose(result[0], numeric, atol=1e-8)


def exchanges_of(*commands: str) -> list[UnitExchange]:
    return [UnitExchange(10.0 * k, 10.0 * k + 0.01, True, c) for k, c in enumerate(commands)]


def exchanges_at(commands: list[tuple[float, str]]) -> list[UnitExchange]:
    return [UnitExchange(at, at + 0.01, True, command) for at, command in commands]


SETTINGS = {
    "pan_acceleration": 2000.0,
    "tilt_acceleration": 2000.0,
    "pan_min_steps": -3090.0,
    "pan_max_steps": 3090.0,
}


def read(exchanges: list[UnitExchange], rests: dict[int, int] | None = None) -> UnitMotion:
    def resting(axis: int, after_s: float, before_s: float) -> int | None:
        assert after_s < before_s
        return (rests or {}).get(axis) if after_s > 3.0 else None

    return MotionReader(SETTINGS, (0, 0), resting).read(translate_exchanges(exchanges))


def test_moves_are_read_from_commands() -> None:
    motion = MotionReader(SETTINGS, (10, -5)).read(
        translate_exchanges(
            exchanges_of("PS500", "PP1010 ", "TS300", "TO-95", "PP1010", "PA4000", "PB100", "PP10")
        )
    )
    assert [(m.axis, m.from_steps, m.to_steps) for m in motion.moves] == [
        (0, 10, 1010),
        (1, -5, -100),
        (0, 1010, 10),
    ]
    assert motion.moves[2].acceleration_steps_s2 == 4000.0
    assert motion.moves[2].base_speed_steps_s == 100.0
    assert motion.moves[0].speed_classes == motion.moves[2].speed_classes
    assert motion.unknown_spans == ()


def test_a_setting_at_rest_leaves_the_move_before_as_it_was() -> None:
    motion = read(exchanges_of("PS500", "PP1000", "PA4000", "PB200", "PP0"))
    assert [m.acceleration_steps_s2 for m in motion.moves] == [2000.0, 4000.0]
    assert [m.base_speed_steps_s for m in motion.moves] == [0.0, 200.0]


def test_slaved_moves_start_together() -> None:
    motion = read(exchanges_of("PS500", "TS500", "S", "PP100", "TP200", "A"))
    assert [m.command_time_s for m in motion.moves] == [50.0, 50.0]


def test_commands_in_motion_belong_to_the_move() -> None:
    motion = read(
        exchanges_at(
            [(0.0, "PS100"), (1.0, "PP1000"), (2.0, "PP-1000"), (3.0, "TS100"), (4.0, "TP50")]
        )
    )
    assert [(m.axis, len(m.commands), m.to_steps) for m in motion.moves] == [
        (0, 2, -1000),
        (1, 1, 50),
    ]
    assert motion.unknown_spans == ()


def test_a_halt_ends_at_the_polled_count() -> None:
    motion = read(
        exchanges_at([(0.0, "PS500"), (1.0, "PP3000"), (3.0, "H"), (9.0, "PO100")]), {0: 1021}
    )
    assert [(m.from_steps, m.to_steps) for m in motion.moves] == [(0, 1021), (1021, 1121)]
    assert [len(m.commands) for m in motion.moves] == [1, 1]
    assert motion.unknown_spans == ()
    unseen = read(exchanges_at([(0.0, "PS500"), (1.0, "PP3000"), (3.0, "H"), (9.0, "PP100")]))
    assert [why for _, _, why in unseen.unknown_spans] == [
        "the recording has no position after a halt or an offset command during a move"
    ]


def test_an_offset_in_motion_ends_at_the_polled_count() -> None:
    motion = read(exchanges_at([(0.0, "PS500"), (1.0, "PP3000"), (3.0, "PO-400")]), {0: 617})
    (move,) = motion.moves
    assert (move.to_steps, len(move.commands), move.commands[1].kind) == (617, 2, "to")


def test_velocity_mode_goes_to_the_limit_until_it_is_halted() -> None:
    motion = read(
        exchanges_at([(0.0, "CV"), (1.0, "PS500"), (3.0, "PS-800"), (5.0, "PS0"), (9.0, "CI")]),
        {0: -77},
    )
    (move,) = motion.moves
    assert [(o.kind, o.steps, o.speed_steps_s) for o in move.commands] == [
        ("to", 3090.0, 500.0),
        ("to", -77.0, 800.0),
    ]


def test_homing_resets_the_count() -> None:
    motion = read(exchanges_at([(0.0, "PS500"), (1.0, "PP300"), (9.0, "RP"), (20.0, "PP100")]))
    assert [(m.from_steps, m.to_steps) for m in motion.moves] == [(0, 300), (0, 100)]
    assert motion.count_resets == ((9.01, 0, 0),)
    assert len(motion.unknown_spans) == 1


def test_a_move_begins_at_the_polled_count() -> None:
    """Another program moved the axis: the command that did it is not recorded."""
    motion = read(exchanges_at([(0.0, "PS500"), (1.0, "PP300"), (9.0, "PP100")]), {0: -55})
    assert [(m.from_steps, m.to_steps) for m in motion.moves] == [(0, 300), (-55, 100)]


def test_unknown_motion_has_a_reason() -> None:
    assert read(exchanges_of("PP100")).unknown_spans
    assert read(exchanges_at([(0.0, "PS100"), (1.0, "PP1000"), (2.0, "PD50")])).unknown_spans
    assert read(exchanges_of("WPE")).unknown_spans


def test_a_refused_command_moves_nothing() -> None:
    refused = [UnitExchange(0.0, 0.01, True, "PS100"), UnitExchange(1.0, 1.1, False, "PP9000")]
    assert read(refused).moves == ()
