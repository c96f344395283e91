"""Trapezoids against their own definition, and kinematics against rotations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gyrorig_solver.reference.kinematics import stage_rate
from gyrorig_solver.reference.moves import Exchange, MotionReader
from gyrorig_solver.reference.trapezoid import Trapezoid


@given(
    distance=st.integers(1, 6000),
    speed=st.floats(31.0, 2900.0),
    ramp=st.floats(200.0, 8000.0),
    base=st.floats(0.0, 1500.0),
)
def test_travel_and_speed_hold(distance: int, speed: float, ramp: float, base: float) -> None:
    move = Trapezoid(float(distance), speed, ramp, base)
    t = np.linspace(0.0, move.duration_s, 2001)
    x = move.position_steps(t)
    assert x[0] == 0.0
    assert x[-1] == pytest.approx(distance, rel=1e-9)
    assert np.all(np.diff(x) >= -1e-9)
    v = move.speed_at_steps_s(t[1:-1])
    assert v.max() <= speed * (1.0 + 1e-9)
    travelled = float(np.trapezoid(move.speed_at_steps_s(t + 0.0), t))
    assert travelled == pytest.approx(distance, rel=5e-3)
    # Symmetric: the second half is the first one backwards.
    assert np.allclose(x + x[::-1], distance, atol=1e-6 * distance + 1e-9)


def test_below_base_speed_there_is_no_ramp() -> None:
    move = Trapezoid(300.0, 500.0, 2000.0, 1000.0)
    assert move.ramp_s == 0.0
    assert move.duration_s == pytest.approx(0.6)


def test_stage_rate_is_the_derivative_of_the_attitude() -> None:
    def attitude(t: float) -> Rotation:
        return Rotation.from_euler("z", 0.4 * t + 0.2) * Rotation.from_euler("x", 0.7 * t * t - 0.3)

    t, h = 0.37, 1e-6
    numeric = (attitude(t - h).inv() * attitude(t + h)).as_rotvec() / (2.0 * h)
    found = stage_rate(np.array([0.7 * t * t - 0.3]), np.array([0.4]), np.array([1.4 * t]))
    assert np.allclose(found[0], numeric, atol=1e-8)


def told(*commands: str) -> list[Exchange]:
    return [Exchange(10.0 * k, 10.0 * k + 0.01, True, c) for k, c in enumerate(commands)]


SETTINGS = {"pan_acceleration": 2000.0, "tilt_acceleration": 2000.0}


def test_moves_are_read_from_commands() -> None:
    motion = MotionReader(SETTINGS, (10, -5)).read(
        told("PS500", "PP1010 ", "TS300", "TO-95", "PP1010", "PA4000", "PB100", "PP10")
    )
    assert [(m.axis, m.from_steps, m.to_steps) for m in motion.moves] == [
        (0, 10, 1010),
        (1, -5, -100),
        (0, 1010, 10),
    ]
    assert motion.moves[2].profile.acceleration_steps_s2 == 4000.0
    assert motion.moves[2].profile.base_speed_steps_s == 100.0
    assert motion.moves[0].speed_class == motion.moves[2].speed_class
    assert motion.unknown == ()


def test_slaved_moves_start_together() -> None:
    motion = MotionReader(SETTINGS, (0, 0)).read(told("PS500", "TS500", "S", "PP100", "TP200", "A"))
    assert [m.told_s for m in motion.moves] == [50.0, 50.0]


def test_a_target_changed_on_the_way_is_not_trusted() -> None:
    quick = [
        Exchange(0.0, 0.01, True, "PS100"),
        Exchange(1.0, 1.01, True, "PP1000"),
        Exchange(2.0, 2.01, True, "PP-1000"),
    ]
    assert MotionReader(SETTINGS, (0, 0)).read(quick).unknown


def test_a_refused_command_moves_nothing() -> None:
    refused = [Exchange(0.0, 0.01, True, "PS100"), Exchange(1.0, 1.1, False, "PP9000")]
    assert MotionReader(SETTINGS, (0, 0)).read(refused).moves == ()
