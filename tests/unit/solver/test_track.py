"""Closed-form trapezoids and tracks of legs against courses laid order by order."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrorig_solver.reference import MotionLimits, MotionProfile, plan_motion
from gyrorig_solver.reference.unit.axis_trajectory import Trajectory, build_trajectories
from gyrorig_solver.reference.unit.motion_profile import ProfileCommand
from gyrorig_solver.reference.unit.move_table import MotionParameters, MoveTable
from gyrorig_solver.reference.unit.recorded_orders import UnitExchange, translate_exchanges
from gyrorig_solver.reference.unit.trapezoidal_moves import TrapezoidalMoves
from gyrorig_solver.reference.unit.unit_moves import MotionReader, UnitMotion

moves = st.tuples(
    st.integers(1, 6000),
    st.floats(31.0, 2900.0),  # steps/s
    st.floats(200.0, 8000.0),  # steps/s^2
    st.floats(0.0, 1500.0),  # base
)
MoveTuple = tuple[int, float, float, float]


def closed(move: MoveTuple) -> TrapezoidalMoves:
    way, speed, acceleration, base = (np.array([float(x)]) for x in move)
    return TrapezoidalMoves.of(way, speed, acceleration, base)


def laid(move: MoveTuple, by_speed: float = 0.0, by_acceleration: float = 0.0) -> MotionProfile:
    way, speed, acceleration, base = move
    law = MotionLimits(speed * np.exp(by_speed), acceleration * np.exp(by_acceleration), base)
    return plan_motion(0.0, [ProfileCommand(0.0, "to", float(way), law)])


def at(result: TrapezoidalMoves, polynomial: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    leg = np.maximum(np.searchsorted(result.segment_start_s[:, 0], time_s, side="right") - 1, 0)
    since = time_s - result.segment_start_s[leg, 0]
    constant, by, square = polynomial[:, leg, 0]
    return np.asarray(constant + (by + square * since) * since)


@given(move=moves)
def test_segments_equal_the_profile_of_one_command(move: MoveTuple) -> None:
    result, course = closed(move), laid(move)
    assert result.end_s[0] == pytest.approx(course.end_s, rel=1e-9)
    t = np.linspace(0.0, course.end_s * 1.1, 400)
    expected = course.position_steps(t)
    assert np.allclose(
        at(result, result.position, t), expected, rtol=1e-9, atol=1e-9 * move[0] + 1e-7
    )


@given(move=moves)
def test_derivatives_are_the_differences(move: MoveTuple) -> None:
    result, course = closed(move), laid(move)
    t = np.linspace(0.0, course.end_s * 1.05, 300)
    step = 1e-5
    for slope, steps in ((result.by_speed, (step, 0.0)), (result.by_acceleration, (0.0, step))):
        ahead, here, behind = (
            laid(move, n * steps[0], n * steps[1]).position_steps(t) for n in (1, 0, -1)
        )
        # A difference smears what jumps; and at the edge between trapezoid and triangle, or
        # at the base speed, the slope is another on either side.
        corners = np.array([*result.segment_start_s[1:3, 0], course.end_s])
        jumps = np.abs(t[:, None] - corners).min(axis=1) < 4.0 * step * (1.0 + course.end_s)
        slopes = [ahead - here, here - behind, (ahead - behind) / 2.0]
        closed_form = at(result, slope, t)
        off = np.min([np.abs(closed_form - slope / step) for slope in slopes], axis=0)
        size = np.abs(closed_form).max() + move[0] * 1e-3
        assert np.all((off < 1e-3 * size) | jumps)


@given(move=moves, share=st.floats(0.001, 0.999))
def test_the_time_of_a_count_is_when_the_course_passes_it(move: MoveTuple, share: float) -> None:
    gone = np.array([share * move[0]])
    passed_s = closed(move).time_at(gone, np.zeros(1, dtype=np.int64))
    assert laid(move).position_steps(passed_s) == pytest.approx(gone, rel=1e-6, abs=1e-6)


SETTINGS = {
    f"{axis}_{kind}": value
    for axis in ("pan", "tilt")
    for kind, value in (("acceleration", 3000.0), ("base_speed", 80.0), ("speed", 900.0))
}


def motion_of(*commands: tuple[float, str]) -> UnitMotion:
    exchanges = [UnitExchange(at_s, at_s + 0.01, True, text) for at_s, text in commands]
    return MotionReader(SETTINGS, (7, -3)).read(translate_exchanges(exchanges))


SCRIPT = (
    (1.0, "PP900"), (1.5, "TP-300"), (4.0, "PP-200"), (4.4, "PP500"), (8.0, "TP200"),
    (8.1, "PP-600"), (12.0, "RP"), (14.0, "PP400"), (18.0, "TP0"),
)  # fmt: skip


def test_a_trajectory_joins_the_profiles() -> None:
    motion = motion_of(*SCRIPT)
    table = MoveTable.of(motion)
    rng = np.random.default_rng(0)
    result = MotionParameters(
        table.command_times_s + rng.uniform(0.0, 0.01, table.command_count),
        rng.uniform(-0.5, 0.5, table.rest_count),
        rng.normal(scale=1e-3, size=table.speed_class_count),
        rng.normal(scale=1e-3, size=2),
    )
    t = np.linspace(0.0, 22.0, 5001)
    for axis, track in enumerate(build_trajectories(table, result)):
        expected = np.full(t.size, float(motion.initial_steps[axis]))
        offset = np.full(t.size, result.rest_offset_steps[table.first_rest(axis)])
        for k in table.moves_of_axis[axis]:
            move = table.moves[k]
            starts_s = result.start_times_s[table.commands_of(int(k))]
            ramp = float(result.log_acceleration[axis])
            course = move.profile(starts_s, result.log_speed, ramp)
            for counted_s, of, steps in motion.count_resets:
                if of == axis and counted_s < course.start_s[0]:
                    homed = (t >= counted_s) & (t < course.start_s[0])
                    expected[homed] = steps
            after = t >= course.start_s[0]
            expected[after] = course.position_steps(t[after])
            before, behind = result.rest_offset_steps[[table.departure[k], table.arrival[k]]]
            offset[after] = before + (behind - before) * course.progress(t[after])
        assert np.allclose(track.sample_sorted(t).steps, expected + offset, atol=1e-6)
        assert np.allclose(track.sample(t).steps, expected + offset, atol=1e-6)
        shuffled = rng.permutation(t.size)
        assert np.array_equal(
            track.sample(t[shuffled]).segment, track.sample_sorted(t).segment[shuffled]
        )
        speed = np.gradient(expected, t)
        smooth = np.abs(track.sample_sorted(t).speed_steps_s - speed) < 0.02 * np.abs(speed).max()
        assert smooth.mean() > 0.99


def test_homing_during_a_move_ends_it() -> None:
    pan, _ = tracks_of((1.0, "PP900"), (1.4, "RP"), (6.0, "PP50"))
    result = pan.sample_sorted(np.array([0.5, 1.2, 2.0, 5.0, 7.0]))
    assert result.steps[[0, 2, 3, 4]] == pytest.approx([7.0, 0.0, 0.0, 50.0])
    assert 7.0 < result.steps[1] < 900.0


def test_a_move_ends_when_the_next_begins() -> None:
    motion = motion_of((1.0, "PP900"), (4.0, "PP0"))
    table = MoveTable.of(motion)
    late = MotionParameters(
        np.array([3.5, 4.0]), np.zeros(table.rest_count), np.zeros(1), np.zeros(2)
    )
    pan, _ = build_trajectories(table, late)
    assert np.all(np.diff(pan.start_s) >= 0.0)
    result = pan.sample_sorted(np.array([3.7, 4.0, 9.0]))
    assert result.move.tolist() == [0, 1, 1]
    assert result.steps[1:] == pytest.approx([900.0, 0.0])


def tracks_of(*commands: tuple[float, str]) -> tuple[Trajectory, Trajectory]:
    table = MoveTable.of(motion_of(*commands))
    return build_trajectories(table, table.commanded_parameters)


def test_no_moves_are_two_rests() -> None:
    pan, tilt = tracks_of()
    time_s = np.array([-5.0, 0.0, 1e6])
    assert pan.sample_sorted(time_s).steps.tolist() == [7.0] * 3
    assert tilt.sample_sorted(time_s).steps.tolist() == [-3.0] * 3
    assert pan.sample_sorted(np.zeros(0)).steps.size == 0
