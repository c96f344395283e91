"""The term of every cause of the unit and its mount explains its effect, without noise."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest
from tests.support.quick_cases import quick_cases


def _load_completeness() -> ModuleType:
    """Return the module `completeness`; the test folders are not a package."""
    name = "hidden_completeness"
    if name not in sys.modules:
        path = Path(__file__).with_name("completeness.py")
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


completeness = _load_completeness()
MIN_EFFECT = 20.0  # energy of a visible effect
CASES = [
    ("axis_nonorthogonality", None, None),
    ("backlash", "pan", None),
    ("backlash", "tilt", None),
    ("base_compliance", "pan", None),
    ("board_slip", None, None),
    ("base_speed_jump", None, None),
    ("base_speed_jump", "pan", None),
    ("eccentricity", "pan", None),
    ("eccentricity", "tilt", None),
    ("lost_steps", "pan", None),
    ("lost_steps", "tilt", None),
    ("lost_steps", "tilt", 1.0),
    ("motor_coupling", None, None),
    ("ringing", "pan", None),
    ("ringing", "tilt", None),
    ("s_curve", None, None),
    ("s_curve", "tilt", None),
    ("step_resolution", "tilt", None),
    ("tilt_sag", "tilt", None),
    ("worm_error", "pan", None),
    ("worm_error", "tilt", None),
]
QUICK = [("backlash", "pan", None), ("eccentricity", "tilt", None), ("lost_steps", "tilt", 1.0)]


@pytest.mark.long
@pytest.mark.parametrize(("cause", "place", "size"), quick_cases(CASES, QUICK))
def test_a_term_explains_its_effect(cause: str, place: str | None, size: float | None) -> None:
    energies = completeness.measure_energies(cause, size, place)
    assert energies.effect > MIN_EFFECT
    assert energies.share <= completeness.GOAL


@pytest.mark.long
@pytest.mark.parametrize(
    ("cause", "place"),
    quick_cases(
        [("acceleration_error", None), ("step_resolution", "pan")], [("acceleration_error", None)]
    ),
)
def test_the_base_model_absorbs_these_effects(cause: str, place: str | None) -> None:
    # The replies of the unit contain its true ramps, and the gain absorbs the step size of pan.
    assert abs(completeness.measure_energies(cause, None, place).effect) < 1.0
