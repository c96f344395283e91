"""What holds for every cause of the catalogue, whatever its physics."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.model import (
    Term,
    causes,
    components_of,
    find_term,
    value_indices,
    value_names,
    value_parameters,
)
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.model.cause_categories import ANGLE_COVARIATES, EDGE_COVARIATES, RATE_COVARIATES

# The contract's table (results: catalogue of causes).
CONTRACT = {
    "clock": "clock_offset clock_skew clock_step clock_sawtooth lost_samples repeated_samples "
    "sample_jitter",
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
    values = []
    for p in value_parameters(find_term(cause)):
        if p.role == "size":
            size = share * p.typical_size * rng.uniform(0.5, 1.0)
            values.append(np.clip(size * (rng.choice([-1.0, 1.0])), p.lower, p.upper))
            if p.lower == 0.0:
                values[-1] = abs(size)
        else:
            values.append(np.nan)
    return np.array(values)


def with_shapes(cause: str, scene: Any, values: np.ndarray) -> np.ndarray:
    bank = find_term(cause).template_bank(scene)
    row = bank[len(bank) // 2]
    return np.where(np.isfinite(values), values, row)


def base_jacobian(rig: Any) -> np.ndarray:
    """G row by row, b, time offset: columns over (blocks * 3), by the scene's own chain."""
    scene = rig.scene
    rate = scene.measure_sensor_rate(scene.rate_rad_s)
    columns = []
    for row in range(3):
        for column in range(3):
            unit_signal = np.zeros((scene.block_count, 3))
            unit_signal[:, row] = rate[:, column]
            columns.append(unit_signal.ravel())
    for axis in range(3):
        unit_signal = np.zeros((scene.block_count, 3))
        unit_signal[:, axis] = 1.0
        columns.append(unit_signal.ravel())
    columns.append(scene.sample_output(scene.filtered_slope_rad_s2).ravel())
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("cause", CAUSES)
def test_parameters_are_sound(cause: str) -> None:
    term = find_term(cause)
    assert term.cause == cause
    names = value_names(term)
    assert len(set(names)) == len(names)
    for p in term.parameters:
        assert p.lower <= p.start <= p.upper
        assert p.lower < p.upper
        assert p.typical_size > 0.0
        assert p.unit
        if p.role == "size":
            assert p.typical_size <= max(abs(p.lower), abs(p.upper))
            assert p.start == 0.0 or term.kind == "known"
    assert term.part == PART_OF[cause]
    assert set(term.confused_with) <= set(PART_OF)
    assert cause not in term.confused_with
    assert term.excitation
    assert term.effect_if_ignored
    for place in components_of(term):
        assert value_indices(term, place)


@pytest.mark.parametrize("cause", CAUSES)
def test_the_card_is_complete(cause: str) -> None:
    term = find_term(cause)
    card = {name for kind in type(term).__mro__ if kind is not Term for name in vars(kind)}
    assert {"title", "equation", "remedy", "covariates", "picture", "part"} <= card
    assert term.title[0].isupper()
    assert term.title == term.title.rstrip(".")
    assert len(term.remedy) > 10
    assert term.remedy == term.remedy.rstrip(".")
    families = {*EDGE_COVARIATES, *ANGLE_COVARIATES, *RATE_COVARIATES}
    assert set(term.covariates or ()) <= families | {"time", "bias_time", "bias_tilt", "move_delay"}
    assert set(term.equivalent_causes) <= set(CAUSES)
    assert term.first_order_equivalent in {"", *CAUSES}
    assert all(p.unit and p.typical_size > 0.0 for p in term.parameters)
    unnamed = [p.name for p in term.parameters if p.name not in term.equation]
    assert unnamed == [], f"the equation does not contain {unnamed}"


NEW_CAUSE = """
from gyrorig_solver.model.causes.bias_ramp import BiasRamp


class NewCause(BiasRamp):
    cause = "new_cause"


TERM = NewCause()
"""


def test_a_new_file_adds_a_cause(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "new_cause.py").write_text(NEW_CAUSE)
    monkeypatch.setattr(causes, "__path__", [*causes.__path__, str(tmp_path)])
    catalogue.cache_clear()
    try:
        assert find_term("new_cause").title == find_term("bias_ramp").title
        assert len(catalogue()) == len(CAUSES) + 1
    finally:
        monkeypatch.undo()
        sys.modules.pop(f"{causes.__name__}.new_cause", None)
        catalogue.cache_clear()


def test_an_unknown_cause_gets_few_suggestions() -> None:
    with pytest.raises(UsageError) as fault:
        find_term("backlsh")
    assert "did you mean backlash" in str(fault.value).lower()
    assert "gyrorigd causes" in str(fault.value)
    assert sum(cause in str(fault.value) for cause in CAUSES) <= 3


@pytest.mark.parametrize("cause", CAUSES)
def test_description_is_readable(cause: str, rig: Any) -> None:
    description = find_term(cause).describe(with_shapes(cause, rig.scene, some_values(cause)))
    assert 10 < len(description) < 200
    assert "nan" not in description


@pytest.mark.parametrize("cause", CAUSES)
def test_zero_size_has_no_effect(cause: str, rig: Any) -> None:
    term = find_term(cause)
    values = with_shapes(cause, rig.scene, some_values(cause))
    values[value_indices(term, role="size")] = 0.0
    assert np.all(term.effect(rig.scene, values) == 0.0)
    begin = np.array([p.start for p in value_parameters(term)])
    if term.kind != "known":
        assert np.all(term.effect(rig.scene, begin) == 0.0)


# One interval after another falls into a dead zone: no derivative, only a secant.
@pytest.mark.parametrize("cause", [c for c in SHOWN if c != "dead_zone"])
def test_jacobian_matches_finite_differences(cause: str, rig: Any) -> None:
    term, scene = find_term(cause), rig.scene
    values = with_shapes(cause, scene, some_values(cause))
    columns = term.jacobian(scene, values)
    assert columns.shape == (values.size, scene.block_count, 3)
    for k, p in enumerate(value_parameters(term)):
        if cause == "backlash" and p.role == "shape":
            continue  # an edge falls into one interval or the next; it is scanned
        if cause == "clock_sawtooth" and p.role != "size":
            continue  # a correction falls between two samples or the next two; it is scanned
        step = np.zeros(values.size)
        # An event inside an interval acts by the interval's share: finer is no derivative.
        steps = term.derivative_step
        step[k] = (0.1 if p.role == "size" else 0.7) * steps * p.typical_size
        difference = term.effect(scene, values + step) - term.effect(scene, values - step)
        difference /= 2 * step[k]
        size = np.linalg.norm(difference)
        assert (
            np.linalg.norm(columns[k] - difference)
            <= (0.03 if p.role == "size" else 0.1) * size + 1e-12
        ), p.name


@pytest.mark.parametrize("cause", SHOWN)
def test_tangent_signals_match_the_template_bank(cause: str, rig: Any) -> None:
    term, scene = find_term(cause), rig.scene
    bank = term.template_bank(scene)
    assert bank.ndim == 2
    sizes = value_indices(term, role="size")
    for row in bank[:: max(1, len(bank) // 3)]:
        tangents = term.tangent_signals(scene, row)
        assert tangents.shape == (len(sizes), scene.block_count, 3)
        assert np.all(np.isfinite(tangents))


@pytest.mark.parametrize("cause", GAUGES)
def test_gain_absorbs_gauge_causes(cause: str, rig: Any) -> None:
    term = find_term(cause)
    values = with_shapes(cause, rig.scene, some_values(cause))
    effect = term.effect(rig.scene, values).ravel()
    if not effect.any():
        return
    base = base_jacobian(rig)
    base = base / np.linalg.norm(base, axis=0)
    left = effect - base @ np.linalg.lstsq(base, effect, rcond=None)[0]
    assert np.linalg.norm(left) < 1e-9 * np.linalg.norm(effect)


def test_catalogue_has_the_ids_of_the_contract() -> None:
    assert set(CAUSES) == set(PART_OF)


def test_unknown_cause_is_rejected() -> None:
    with pytest.raises(UsageError, match="is not the name of a known cause"):
        find_term("gremlins")
