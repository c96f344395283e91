"""Courses against closed forms and their own invariants, moves against what was told."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gyrorig_solver.reference.course import Course, Instruction, Kind, Limits, lay
from gyrorig_solver.reference.kinematics import stage_rate
from gyrorig_solver.reference.moves import Exchange, Motion, MotionReader
from gyrorig_solver.reference.slopes import slopes

USUAL = Limits(speed_steps_s=1000.0, acceleration_steps_s2=2000.0, base_speed_steps_s=100.0)
limits = st.builds(
    Limits,
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
Told = list[tuple[float, Kind, int, Limits]]


def laid(told: Told) -> Course:
    at, given_orders = 0.0, []
    base = told[0][3].base_speed_steps_s  # a unit does not change it on the way
    for wait_s, kind, steps, own in told:
        at += wait_s
        law = Limits(own.speed_steps_s, own.acceleration_steps_s2, base)
        given_orders.append(Instruction(at, kind, float(steps), law))
    return lay(0.0, given_orders)


def alone(distance: float, law: Limits) -> Course:
    return lay(0.0, [Instruction(0.0, "to", distance, law)])


@given(distance=st.integers(1, 6000), law=limits)
def test_travel_and_speed_hold(distance: int, law: Limits) -> None:
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
    assert np.allclose(course.share(t), x / distance, atol=1e-9)


def test_a_long_move_is_the_trapezoid_of_the_manual() -> None:
    """Ramp 100 to 1000 at 2000 steps/s^2: 0.45 s and (1000^2 - 100^2) / 4000 = 247.5 steps."""
    course = alone(3000.0, USUAL)
    assert course.acceleration.tolist() == [2000.0, 0.0, -2000.0, 0.0]
    cruise_s = (3000.0 - 2.0 * 247.5) / 1000.0
    assert course.start_s == pytest.approx([0.0, 0.45, 0.45 + cruise_s, 0.9 + cruise_s])
    assert course.steps == pytest.approx([0.0, 247.5, 2752.5, 3000.0])


def test_a_short_move_is_a_triangle() -> None:
    """Peak^2 = a D + base^2."""
    course = alone(-100.0, USUAL)
    peak = np.sqrt(2000.0 * 100.0 + 100.0**2)
    assert course.end_s == pytest.approx(2.0 * (peak - 100.0) / 2000.0)
    assert course.speed_steps_s(np.array([course.end_s / 2.0]))[0] == pytest.approx(-peak)


def test_below_base_speed_there_is_no_ramp() -> None:
    course = alone(300.0, Limits(500.0, 2000.0, 1000.0))
    assert course.end_s == pytest.approx(0.6)
    assert course.acceleration.tolist() == [0.0, 0.0]


def test_a_reversal_brakes_through_base_speed_and_comes_back() -> None:
    course = lay(
        0.0, [Instruction(0.0, "to", 3000.0, USUAL), Instruction(1.0, "to", -500.0, USUAL)]
    )
    # 247.5 steps of ramp and 0.55 s of cruise; then 0.45 s and 247.5 steps to brake.
    turn_s, turn = 1.45, 247.5 + 550.0 + 247.5
    assert course.position_steps(np.array([1.0, turn_s])) == pytest.approx([797.5, turn])
    back = alone(turn + 500.0, USUAL)
    assert course.end_s == pytest.approx(turn_s + back.end_s)
    t = np.linspace(0.0, back.end_s, 50)
    assert course.position_steps(turn_s + t) == pytest.approx(turn - back.position_steps(t))


def test_a_halt_brakes_and_stands() -> None:
    course = lay(0.0, [Instruction(0.0, "to", 3000.0, USUAL), Instruction(1.0, "stop", 0.0, USUAL)])
    assert course.steps[-1] == pytest.approx(797.5 + 247.5)
    assert course.end_s == pytest.approx(1.45)
    # The move to where it stopped is the same move: what makes a polled rest enough.
    same = alone(float(course.steps[-1]), USUAL)
    t = np.linspace(0.0, 2.0, 100)
    assert course.position_steps(t) == pytest.approx(same.position_steps(t), abs=1e-6)


@given(told=orders)
def test_position_is_continuous_and_speed_within_the_law(told: Told) -> None:
    course = laid(told)
    base = told[0][3].base_speed_steps_s
    length = np.diff(course.start_s)
    assert np.all(length >= 0.0)
    end_speed = course.speed[:-1] + course.acceleration[:-1] * length
    end = course.steps[:-1] + 0.5 * (course.speed[:-1] + end_speed) * length
    assert np.allclose(end, course.steps[1:], atol=1e-4)
    jump = np.abs(course.speed[1:] - end_speed)
    slow = np.maximum(np.abs(course.speed[1:]), np.abs(end_speed)) <= base + 1e-6
    assert np.all((jump < 1e-4) | slow)
    assert course.speed[-1] == 0.0
    assert np.all(np.diff(course.way) >= 0.0)


def test_slopes_of_several_orders_are_the_differences() -> None:
    motion = read(told_at([(0.0, "PS1000"), (1.0, "PP3000"), (2.2, "PS600"), (3.0, "PP-700")]))
    (move,) = motion.moves
    assert [o.kind for o in move.orders] == ["to", "keep", "to"]
    still = np.zeros(motion.classes)
    t = np.linspace(1.01, 8.0, 500)
    found = slopes(move, move.starts_s, still, 0.0, t)
    here = move.course(move.starts_s, still, 0.0).position_steps(t)
    assert found.starts.sum(axis=0) == pytest.approx(
        -move.course(move.starts_s, still, 0.0).speed_steps_s(t), abs=0.3
    )
    for k in range(3):
        later = move.starts_s + 1e-3 * (np.arange(3) == k)
        change = move.course(later, still, 0.0).position_steps(t) - here
        assert change == pytest.approx(1e-3 * found.starts[k], abs=0.01)


def test_stage_rate_is_the_derivative_of_the_attitude() -> None:
    def attitude(t: float) -> Rotation:
        return Rotation.from_euler("z", 0.4 * t + 0.2) * Rotation.from_euler("x", 0.7 * t * t - 0.3)

    t, h = 0.37, 1e-6
    numeric = (attitude(t - h).inv() * attitude(t + h)).as_rotvec() / (2.0 * h)
    found = stage_rate(np.array([0.7 * t * t - 0.3]), np.array([0.4]), np.array([1.4 * t]))
    assert np.allclose(found[0], numeric, atol=1e-8)


def told(*commands: str) -> list[Exchange]:
    return [Exchange(10.0 * k, 10.0 * k + 0.01, True, c) for k, c in enumerate(commands)]


def told_at(commands: list[tuple[float, str]]) -> list[Exchange]:
    return [Exchange(at, at + 0.01, True, command) for at, command in commands]


SETTINGS = {
    "pan_acceleration": 2000.0,
    "tilt_acceleration": 2000.0,
    "pan_min_steps": -3090.0,
    "pan_max_steps": 3090.0,
}


def read(exchanges: list[Exchange], rests: dict[int, int] | None = None) -> Motion:
    def resting(axis: int, after_s: float, before_s: float) -> int | None:
        assert after_s < before_s
        return (rests or {}).get(axis) if after_s > 3.0 else None

    return MotionReader(SETTINGS, (0, 0), resting).read(exchanges)


def test_moves_are_read_from_commands() -> None:
    motion = MotionReader(SETTINGS, (10, -5)).read(
        told("PS500", "PP1010 ", "TS300", "TO-95", "PP1010", "PA4000", "PB100", "PP10")
    )
    assert [(m.axis, m.from_steps, m.to_steps) for m in motion.moves] == [
        (0, 10, 1010),
        (1, -5, -100),
        (0, 1010, 10),
    ]
    assert motion.moves[2].acceleration_steps_s2 == 4000.0
    assert motion.moves[2].base_speed_steps_s == 100.0
    assert motion.moves[0].classes == motion.moves[2].classes
    assert motion.unknown == ()


def test_a_setting_at_rest_leaves_the_move_before_as_it_was() -> None:
    motion = read(told("PS500", "PP1000", "PA4000", "PB200", "PP0"))
    assert [m.acceleration_steps_s2 for m in motion.moves] == [2000.0, 4000.0]
    assert [m.base_speed_steps_s for m in motion.moves] == [0.0, 200.0]


def test_slaved_moves_start_together() -> None:
    motion = read(told("PS500", "TS500", "S", "PP100", "TP200", "A"))
    assert [m.told_s for m in motion.moves] == [50.0, 50.0]


def test_orders_on_the_way_belong_to_the_move() -> None:
    motion = read(
        told_at([(0.0, "PS100"), (1.0, "PP1000"), (2.0, "PP-1000"), (3.0, "TS100"), (4.0, "TP50")])
    )
    assert [(m.axis, len(m.orders), m.to_steps) for m in motion.moves] == [
        (0, 2, -1000),
        (1, 1, 50),
    ]
    assert motion.unknown == ()


def test_a_halt_ends_where_the_counts_say() -> None:
    motion = read(told_at([(0.0, "PS500"), (1.0, "PP3000"), (3.0, "H"), (9.0, "PO100")]), {0: 1021})
    assert [(m.from_steps, m.to_steps) for m in motion.moves] == [(0, 1021), (1021, 1121)]
    assert [len(m.orders) for m in motion.moves] == [1, 1]
    assert motion.unknown == ()
    unseen = read(told_at([(0.0, "PS500"), (1.0, "PP3000"), (3.0, "H"), (9.0, "PP100")]))
    assert [why for _, _, why in unseen.unknown] == [
        "where a halt or an offset on the way ended was not polled"
    ]


def test_an_offset_on_the_way_ends_where_the_counts_say() -> None:
    motion = read(told_at([(0.0, "PS500"), (1.0, "PP3000"), (3.0, "PO-400")]), {0: 617})
    (move,) = motion.moves
    assert (move.to_steps, len(move.orders), move.orders[1].kind) == (617, 2, "to")


def test_velocity_mode_goes_to_the_limit_until_it_is_halted() -> None:
    motion = read(
        told_at([(0.0, "CV"), (1.0, "PS500"), (3.0, "PS-800"), (5.0, "PS0"), (9.0, "CI")]), {0: -77}
    )
    (move,) = motion.moves
    assert [(o.kind, o.steps, o.speed_steps_s) for o in move.orders] == [
        ("to", 3090.0, 500.0),
        ("to", -77.0, 800.0),
    ]


def test_homing_counts_anew() -> None:
    motion = read(told_at([(0.0, "PS500"), (1.0, "PP300"), (9.0, "RP"), (20.0, "PP100")]))
    assert [(m.from_steps, m.to_steps) for m in motion.moves] == [(0, 300), (0, 100)]
    assert motion.recounts == ((9.01, 0, 0),)
    assert len(motion.unknown) == 1


def test_a_move_begins_where_the_counts_say() -> None:
    """Another program moved the axis: the command that did it is not recorded."""
    motion = read(told_at([(0.0, "PS500"), (1.0, "PP300"), (9.0, "PP100")]), {0: -55})
    assert [(m.from_steps, m.to_steps) for m in motion.moves] == [(0, 300), (-55, 100)]


def test_what_is_not_known_is_said() -> None:
    assert read(told("PP100")).unknown
    assert read(told_at([(0.0, "PS100"), (1.0, "PP1000"), (2.0, "PD50")])).unknown
    assert read(told("WPE")).unknown


def test_a_refused_command_moves_nothing() -> None:
    refused = [Exchange(0.0, 0.01, True, "PS100"), Exchange(1.0, 1.1, False, "PP9000")]
    assert read(refused).moves == ()
