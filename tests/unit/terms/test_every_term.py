"""What holds for every cause of the catalogue, whatever its physics."""

from typing import Any

import numpy as np
import pytest

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.model.terms.catalogue import catalogue, term
from gyrorig_solver.model.terms.protocol import indices, places, value_names, value_parameters

# The contract's table (results: catalogue of causes).
CONTRACT = {
    "clock": "clock_offset clock_skew clock_step lost_samples repeated_samples sample_jitter",
    "link": "corrupt_samples axis_swap sign_flip wrong_full_scale",
    "sensor": "low_pass_lag scale_quadratic scale_cubic scale_asymmetry saturation dead_zone "
    "g_sensitivity vibration_rectification thermal_bias thermal_scale warm_up bias_ramp "
    "bias_step bias_random_walk supply_hum motor_coupling",
    "ptu": "backlash lost_steps eccentricity worm_error axis_nonorthogonality tilt_zero "
    "step_resolution acceleration_error s_curve base_speed_jump ringing tilt_sag "
    "base_compliance",
    "mount": "board_slip",
    "environment": "earth_rotation",
}
PART_OF = {cause: part for part, ids in CONTRACT.items() for cause in ids.split()}
CAUSES = tuple(catalogue())
SHOWN = tuple(c for c in CAUSES if catalogue()[c].kind in ("effect", "known", "gauge"))
GAUGES = tuple(c for c in CAUSES if catalogue()[c].kind == "gauge")


def some_values(cause: str, seed: int = 0, share: float = 1.0) -> np.ndarray:
    """Typical sizes with random signs inside the bounds; shapes from the middle of the bank."""
    rng = np.random.default_rng(seed)
    found = []
    for p in value_parameters(term(cause)):
        if p.role == "size":
            size = share * p.typical * rng.uniform(0.5, 1.0)
            found.append(np.clip(size * (rng.choice([-1.0, 1.0])), p.lower, p.upper))
            if p.lower == 0.0:
                found[-1] = abs(size)
        else:
            found.append(np.nan)
    return np.array(found)


def with_shapes(cause: str, scene: Any, values: np.ndarray) -> np.ndarray:
    bank = term(cause).bank(scene)
    row = bank[len(bank) // 2]
    return np.where(np.isfinite(values), values, row)


def base_jacobian(rig: Any) -> np.ndarray:
    """G row by row, b, time offset: columns over (blocks * 3), by the scene's own chain."""
    scene = rig.scene
    rate = scene.seen(scene.rate_rad_s)
    columns = []
    for row in range(3):
        for column in range(3):
            one = np.zeros((scene.blocks, 3))
            one[:, row] = rate[:, column]
            columns.append(one.ravel())
    for axis in range(3):
        one = np.zeros((scene.blocks, 3))
        one[:, axis] = 1.0
        columns.append(one.ravel())
    columns.append(scene.read(scene.filtered_slope_rad_s2).ravel())
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("cause", CAUSES)
def test_parameters_are_sound(cause: str) -> None:
    one = term(cause)
    assert one.cause == cause
    names = value_names(one)
    assert len(set(names)) == len(names)
    for p in one.parameters:
        assert p.lower <= p.start <= p.upper
        assert p.lower < p.upper
        assert p.typical > 0.0
        assert p.unit
        if p.role == "size":
            assert p.typical <= max(abs(p.lower), abs(p.upper))
            assert p.start == 0.0 or one.kind == "known"
    assert one.part == PART_OF[cause]
    assert set(one.confused_with) <= set(PART_OF)
    assert cause not in one.confused_with
    assert one.excitation
    assert one.harm
    for place in places(one):
        assert indices(one, place)


@pytest.mark.parametrize("cause", CAUSES)
def test_it_says_itself_in_words(cause: str, rig: Any) -> None:
    said = term(cause).sentence(with_shapes(cause, rig.scene, some_values(cause)))
    assert 10 < len(said) < 200
    assert "nan" not in said


@pytest.mark.parametrize("cause", CAUSES)
def test_no_size_no_effect(cause: str, rig: Any) -> None:
    one = term(cause)
    values = with_shapes(cause, rig.scene, some_values(cause))
    values[indices(one, role="size")] = 0.0
    assert np.all(one.effect(rig.scene, values) == 0.0)
    begin = np.array([p.start for p in value_parameters(one)])
    if one.kind != "known":
        assert np.all(one.effect(rig.scene, begin) == 0.0)


# One interval after another falls into a dead zone: no derivative, only a secant.
@pytest.mark.parametrize("cause", [c for c in SHOWN if c != "dead_zone"])
def test_columns_are_derivatives(cause: str, rig: Any) -> None:
    one, scene = term(cause), rig.scene
    values = with_shapes(cause, scene, some_values(cause))
    columns = one.columns(scene, values)
    assert columns.shape == (values.size, scene.blocks, 3)
    for k, p in enumerate(value_parameters(one)):
        if cause == "backlash" and p.role == "shape":
            continue  # the first contact falls into one interval or the next; it is scanned
        step = np.zeros(values.size)
        # An event inside an interval acts by the interval's share: finer is no derivative.
        own = one.derivative_step  # type: ignore[attr-defined]
        step[k] = (0.1 if p.role == "size" else 0.7) * own * p.typical
        difference = one.effect(scene, values + step) - one.effect(scene, values - step)
        difference /= 2 * step[k]
        size = np.linalg.norm(difference)
        assert (
            np.linalg.norm(columns[k] - difference)
            <= (0.03 if p.role == "size" else 0.1) * size + 1e-12
        ), p.name


@pytest.mark.parametrize("cause", SHOWN)
def test_directions_go_with_the_bank(cause: str, rig: Any) -> None:
    one, scene = term(cause), rig.scene
    bank = one.bank(scene)
    assert bank.ndim == 2
    sizes = indices(one, role="size")
    for row in bank[:: max(1, len(bank) // 3)]:
        found = one.directions(scene, row)
        assert found.shape == (len(sizes), scene.blocks, 3)
        assert np.all(np.isfinite(found))


@pytest.mark.parametrize("cause", GAUGES)
def test_gauges_are_absorbed_whole(cause: str, rig: Any) -> None:
    one = term(cause)
    values = with_shapes(cause, rig.scene, some_values(cause))
    effect = one.effect(rig.scene, values).ravel()
    if not effect.any():
        return
    base = base_jacobian(rig)
    base = base / np.linalg.norm(base, axis=0)
    left = effect - base @ np.linalg.lstsq(base, effect, rcond=None)[0]
    assert np.linalg.norm(left) < 1e-9 * np.linalg.norm(effect)


def test_the_contract_is_kept() -> None:
    assert set(CAUSES) == set(PART_OF)


def test_an_unknown_cause_is_refused() -> None:
    with pytest.raises(UsageError, match="no cause is called"):
        term("gremlins")
