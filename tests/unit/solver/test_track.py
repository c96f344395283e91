"""Closed-form trapezoids and tracks of legs against courses laid order by order."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrorig_solver.reference.course import Course, Instruction, Limits, lay
from gyrorig_solver.reference.moves import Exchange, Motion, MotionReader
from gyrorig_solver.reference.table import MoveTable, Unknowns
from gyrorig_solver.reference.track import Track, lay_tracks
from gyrorig_solver.reference.trapezoid import Trapezoids

moves = st.tuples(
    st.integers(1, 6000),
    st.floats(31.0, 2900.0),  # steps/s
    st.floats(200.0, 8000.0),  # steps/s^2
    st.floats(0.0, 1500.0),  # base
)
Told = tuple[int, float, float, float]


def closed(told: Told) -> Trapezoids:
    way, speed, acceleration, base = (np.array([float(x)]) for x in told)
    return Trapezoids.of(way, speed, acceleration, base)


def laid(told: Told, by_speed: float = 0.0, by_acceleration: float = 0.0) -> Course:
    way, speed, acceleration, base = told
    law = Limits(speed * np.exp(by_speed), acceleration * np.exp(by_acceleration), base)
    return lay(0.0, [Instruction(0.0, "to", float(way), law)])


def at(found: Trapezoids, polynomial: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    leg = np.maximum(np.searchsorted(found.leg_s[:, 0], time_s, side="right") - 1, 0)
    since = time_s - found.leg_s[leg, 0]
    one, by, square = polynomial[:, leg, 0]
    return np.asarray(one + (by + square * since) * since)


@given(told=moves)
def test_legs_are_the_course_of_one_order(told: Told) -> None:
    found, course = closed(told), laid(told)
    assert found.end_s[0] == pytest.approx(course.end_s, rel=1e-9)
    t = np.linspace(0.0, course.end_s * 1.1, 400)
    expected = course.position_steps(t)
    assert np.allclose(at(found, found.gone, t), expected, rtol=1e-9, atol=1e-9 * told[0] + 1e-7)


@given(told=moves)
def test_derivatives_are_the_differences(told: Told) -> None:
    found, course = closed(told), laid(told)
    t = np.linspace(0.0, course.end_s * 1.05, 300)
    step = 1e-5
    for slope, own in ((found.by_speed, (step, 0.0)), (found.by_acceleration, (0.0, step))):
        ahead, here, behind = (
            laid(told, n * own[0], n * own[1]).position_steps(t) for n in (1, 0, -1)
        )
        # A difference smears what jumps; and at the edge between trapezoid and triangle, or
        # at the base speed, the slope is another on either side.
        corners = np.array([*found.leg_s[1:3, 0], course.end_s])
        jumps = np.abs(t[:, None] - corners).min(axis=1) < 4.0 * step * (1.0 + course.end_s)
        slopes = [ahead - here, here - behind, (ahead - behind) / 2.0]
        closed_form = at(found, slope, t)
        off = np.min([np.abs(closed_form - one / step) for one in slopes], axis=0)
        size = np.abs(closed_form).max() + told[0] * 1e-3
        assert np.all((off < 1e-3 * size) | jumps)


@given(told=moves, share=st.floats(0.001, 0.999))
def test_the_time_of_a_count_is_when_the_course_passes_it(told: Told, share: float) -> None:
    gone = np.array([share * told[0]])
    passed_s = closed(told).passed_s(gone, np.zeros(1, dtype=np.int64))
    assert laid(told).position_steps(passed_s) == pytest.approx(gone, rel=1e-6, abs=1e-6)


SETTINGS = {
    f"{axis}_{kind}": value
    for axis in ("pan", "tilt")
    for kind, value in (("acceleration", 3000.0), ("base_speed", 80.0), ("speed", 900.0))
}


def motion_of(*commands: tuple[float, str]) -> Motion:
    exchanges = [Exchange(at_s, at_s + 0.01, True, text) for at_s, text in commands]
    return MotionReader(SETTINGS, (7, -3)).read(exchanges)


SCRIPT = (
    (1.0, "PP900"), (1.5, "TP-300"), (4.0, "PP-200"), (4.4, "PP500"), (8.0, "TP200"),
    (8.1, "PP-600"), (12.0, "RP"), (14.0, "PP400"), (18.0, "TP0"),
)  # fmt: skip


def test_a_track_is_its_courses_one_after_the_other() -> None:
    motion = motion_of(*SCRIPT)
    table = MoveTable.of(motion)
    rng = np.random.default_rng(0)
    found = Unknowns(
        table.told_s + rng.uniform(0.0, 0.01, table.starts),
        rng.uniform(-0.5, 0.5, table.rests),
        rng.normal(scale=1e-3, size=table.classes),
        rng.normal(scale=1e-3, size=2),
    )
    t = np.linspace(0.0, 22.0, 5001)
    for axis, track in enumerate(lay_tracks(table, found)):
        expected = np.full(t.size, float(motion.rest_steps[axis]))
        offset = np.full(t.size, found.rest_steps[table.first_rest(axis)])
        for k in table.own[axis]:
            move = table.moves[k]
            starts_s = found.starts_s[table.orders(int(k))]
            ramp = float(found.log_acceleration[axis])
            course = move.course(starts_s, found.log_speed, ramp)
            for counted_s, of, steps in motion.recounts:
                if of == axis and counted_s < course.start_s[0]:
                    homed = (t >= counted_s) & (t < course.start_s[0])
                    expected[homed] = steps
            after = t >= course.start_s[0]
            expected[after] = course.position_steps(t[after])
            before, behind = found.rest_steps[[table.departure[k], table.arrival[k]]]
            offset[after] = before + (behind - before) * course.share(t[after])
        assert np.allclose(track.along(t).steps, expected + offset, atol=1e-6)
        assert np.allclose(track.at(t).steps, expected + offset, atol=1e-6)
        shuffled = rng.permutation(t.size)
        assert np.array_equal(track.at(t[shuffled]).leg, track.along(t).leg[shuffled])
        speed = np.gradient(expected, t)
        smooth = np.abs(track.along(t).speed_steps_s - speed) < 0.02 * np.abs(speed).max()
        assert smooth.mean() > 0.99


def test_homing_on_the_way_ends_the_move() -> None:
    pan, _ = tracks_of((1.0, "PP900"), (1.4, "RP"), (6.0, "PP50"))
    found = pan.along(np.array([0.5, 1.2, 2.0, 5.0, 7.0]))
    assert found.steps[[0, 2, 3, 4]] == pytest.approx([7.0, 0.0, 0.0, 50.0])
    assert 7.0 < found.steps[1] < 900.0


def test_a_move_that_is_not_over_gives_way_to_the_next() -> None:
    motion = motion_of((1.0, "PP900"), (4.0, "PP0"))
    table = MoveTable.of(motion)
    late = Unknowns(np.array([3.5, 4.0]), np.zeros(table.rests), np.zeros(1), np.zeros(2))
    pan, _ = lay_tracks(table, late)
    assert np.all(np.diff(pan.start_s) >= 0.0)
    found = pan.along(np.array([3.7, 4.0, 9.0]))
    assert found.move.tolist() == [0, 1, 1]
    assert found.steps[1:] == pytest.approx([900.0, 0.0])


def tracks_of(*commands: tuple[float, str]) -> tuple[Track, Track]:
    table = MoveTable.of(motion_of(*commands))
    return lay_tracks(table, table.as_told)


def test_no_moves_are_two_rests() -> None:
    pan, tilt = tracks_of()
    time_s = np.array([-5.0, 0.0, 1e6])
    assert pan.along(time_s).steps.tolist() == [7.0] * 3
    assert tilt.along(time_s).steps.tolist() == [-3.0] * 3
    assert pan.along(np.zeros(0)).steps.size == 0
