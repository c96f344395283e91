"""Gravity, temperature, the Earth and the axes: each against its own simulation.

The simulations work with attitudes as matrices over time, differentiated numerically where
the terms have closed forms.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrorig_solver.model import BoardTemperature, Site, find_term, why_not_computable
from gyrorig_solver.model.causes.axis_nonorthogonality import AxisNonOrthogonality
from gyrorig_solver.model.causes.earth_rotation import EARTH_RATE_RAD_S, earth_axis_in_base
from gyrorig_solver.model.causes.thermal_bias import ThermalBias
from gyrorig_solver.model.causes.tilt_zero import TiltZero

Attitude = Callable[[np.ndarray], Rotation]


def about(axis: str, angle_rad: Any) -> Rotation:
    """Rotation about x, y or z by one angle or many."""
    unit = np.eye(3)["xyz".index(axis)]
    return Rotation.from_rotvec(np.multiply.outer(np.asarray(angle_rad), unit))


def body_rate(attitude: Attitude, time_s: np.ndarray) -> np.ndarray:
    """Rate in the stage frame by differences of attitudes."""
    h = 0.5 * (time_s[1] - time_s[0])
    before, after = attitude(time_s - h), attitude(time_s + h)
    return np.asarray((before.inv() * after).as_rotvec() / (2.0 * h))


def close(ours: np.ndarray, theirs: np.ndarray, share: float) -> None:
    assert np.linalg.norm(theirs) > 0.0
    assert np.linalg.norm(ours - theirs) < share * np.linalg.norm(theirs)


def test_g_sensitivity_follows_tilt(rig: Any) -> None:
    matrix = 2e-4 * np.array([[9.0, 1.0, -0.5], [0.0, 0.8, 0.3], [0.0, -0.2, 0.6]])

    def with_gravity(time_s: np.ndarray) -> np.ndarray:
        attitude = about("z", rig.pan(time_s)) * about("x", rig.tilt(time_s))
        up = attitude.inv().apply([0.0, 0.0, 9.80665])
        return np.asarray(rig.base()(time_s) + up @ matrix.T)

    ours = find_term("g_sensitivity").effect(rig.scene, matrix.ravel())
    close(ours, rig.difference(with_gravity), 1e-3)


def test_g_sensitivity_needs_several_tilts(rig: Any) -> None:
    term = find_term("g_sensitivity")
    assert why_not_computable(term, [rig.scene]) is None
    level = rig.build(seconds=5.0)
    assert "four tilts" in str(why_not_computable(term, [level]))


def test_thermal_bias_follows_the_temperature(rig: Any) -> None:
    slope, square = np.array([5e-4, -3e-4, 1e-4]), np.array([2e-5, 0.0, -1e-5])
    mean = rig.scene.context.temperature.mean_degc

    def warm(time_s: np.ndarray) -> np.ndarray:
        rise = rig.temperature(time_s)[:, None] - mean
        return np.asarray(rig.base()(time_s) + slope * rise + square * rise**2)

    ours = ThermalBias(2).effect(rig.scene, np.concatenate([slope, square, [0.0]]))
    close(ours, rig.difference(warm), 2e-3)


def test_thermal_bias_has_at_most_three_orders() -> None:
    assert ThermalBias(3).parameters[2].unit == "rad/s/K^3"
    with pytest.raises(ValueError, match="order 4"):
        ThermalBias(4)


def test_thermal_scale_follows_the_temperature(rig: Any) -> None:
    slope = np.array([2e-4, -1e-4, 3e-4])
    mean = rig.scene.context.temperature.mean_degc

    def warm(time_s: np.ndarray) -> np.ndarray:
        rise = rig.temperature(time_s)[:, None] - mean
        return np.asarray(rig.base()(time_s) * (1.0 + slope * rise))

    close(find_term("thermal_scale").effect(rig.scene, slope), rig.difference(warm), 2e-3)


def test_thermal_causes_need_a_thermometer(rig: Any) -> None:
    cold = rig.build(with_temperature=False)
    for cause in ("thermal_bias", "thermal_scale"):
        assert "no temperature" in str(why_not_computable(find_term(cause), [cold]))
        assert (
            not find_term(cause).effect(cold, np.full(4, 1e-4)[: 4 if "bias" in cause else 3]).any()
        )


def test_stuck_thermometer_makes_thermal_causes_untestable(rig: Any) -> None:
    grid_s = np.arange(-1.0, 32.0)
    stuck = BoardTemperature(grid_s, np.full(grid_s.size, 25.0), 25.0)
    scene = replace(rig.scene, context=replace(rig.scene.context, temperature=stuck))
    for cause in ("thermal_bias", "thermal_scale"):
        assert "the temperature changed by only 0.0 K" in str(
            why_not_computable(find_term(cause), [scene])
        )
        assert (
            why_not_computable(find_term(cause), [rig.scene]) is None
        )  # that one's temperature does change


@pytest.mark.long
@pytest.mark.parametrize(("latitude", "heading"), [(52.0, 30.0), (-34.0, 250.0)])
def test_earth_rotation_at_a_site(rig: Any, latitude: float, heading: float) -> None:
    """The rig carried round by the Earth: attitudes in space, differentiated."""
    phi, h = np.radians([latitude, heading])
    # Columns: the base's axes in an Earth-fixed frame with z along the Earth's axis, at
    # longitude 0, from east, north and up written out there.
    east = np.array([0.0, 1.0, 0.0])
    north = np.array([-np.sin(phi), 0.0, np.cos(phi)])
    up = np.array([np.cos(phi), 0.0, np.sin(phi)])
    y = np.sin(h) * east + np.cos(h) * north
    base = Rotation.from_matrix(np.stack([np.cross(y, up), y, up], axis=1))

    def still(time_s: np.ndarray) -> Rotation:
        return base * about("z", rig.pan(time_s)) * about("x", rig.tilt(time_s))

    def carried(time_s: np.ndarray) -> Rotation:
        return about("z", EARTH_RATE_RAD_S * time_s) * still(time_s)

    def with_earth(time_s: np.ndarray) -> np.ndarray:
        return np.asarray(body_rate(carried, time_s) @ rig.gain.T)

    def without(time_s: np.ndarray) -> np.ndarray:
        return np.asarray(body_rate(still, time_s) @ rig.gain.T)

    theirs = rig.measured(with_earth) - rig.measured(without)
    scene = rig.build(site=Site(latitude, heading))
    close(find_term("earth_rotation").effect(scene, np.array([EARTH_RATE_RAD_S])), theirs, 2e-3)


def test_earth_rotation_at_poles_and_equator() -> None:
    pole, equator = earth_axis_in_base(Site(90.0, 77.0)), earth_axis_in_base(Site(0.0, 90.0))
    assert pole == pytest.approx([0.0, 0.0, 1.0])
    # Facing east at the equator, north is to the left.
    assert equator == pytest.approx([-1.0, 0.0, 0.0])
    assert earth_axis_in_base(Site(52.0, None)) is None


def test_earth_rotation_needs_the_site(rig: Any) -> None:
    nowhere = rig.build(site=Site(latitude_deg=52.0))
    assert "heading_deg" in str(why_not_computable(find_term("earth_rotation"), [nowhere]))
    assert why_not_computable(find_term("earth_rotation"), [rig.scene]) is None


def test_nonorthogonal_axes(rig: Any) -> None:
    angle = 0.02

    def attitude(time_s: np.ndarray) -> Rotation:
        # The tilt axis is carried at an angle: a lean of the carrier about y.
        return about("z", rig.pan(time_s)) * about("y", -angle) * about("x", rig.tilt(time_s))

    def leaning(time_s: np.ndarray) -> np.ndarray:
        return np.asarray(body_rate(attitude, time_s) @ rig.gain.T)

    ours = AxisNonOrthogonality().effect(rig.scene, np.array([angle]))
    close(ours, rig.difference(leaning), 2e-3)


def test_tilt_zero_rotates_the_stage(rig: Any) -> None:
    angle = 0.03
    off = rig.sensor(rig.pan, lambda t: rig.tilt(t) + angle)
    ours = TiltZero().effect(rig.scene, np.array([angle]))
    close(ours, rig.difference(off), 2e-3)
    assert "misalignment about x" in str(why_not_computable(TiltZero(), [rig.scene]))
