"""The term of every cause of the sensor and its clock explains its whole effect.

Without noise the residual is the error of the term. The thermal causes need a room that warms up
and cools down, because the board alone changes by only 0.2 K in a short session.
"""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest
from tests.support.quick_cases import quick_cases


def _load_completeness() -> ModuleType:
    """Return the module `completeness`; the test folders are not a package."""
    path = Path(__file__).with_name("completeness.py")
    spec = importlib.util.spec_from_file_location("hidden_completeness", path)
    if spec is None or spec.loader is None:
        raise ImportError(path)
    if spec.name not in sys.modules:
        sys.modules[spec.name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[spec.name])
    return sys.modules[spec.name]


SOAK_K = 15.0
CAUSES = [
    "bias_ramp",
    "bias_step",
    "clock_skew",
    "clock_step",
    "dead_zone",
    "g_sensitivity",
    "low_pass_lag",
    "saturation",
    "scale_asymmetry",
    "scale_cubic",
    "scale_quadratic",
    "supply_hum",
    "vibration_rectification",
    "warm_up",
]
QUICK = ["clock_step", "dead_zone", "warm_up"]


@pytest.mark.long
@pytest.mark.parametrize("cause", quick_cases(CAUSES, QUICK))
def test_a_term_explains_its_effect(cause: str) -> None:
    completeness = _load_completeness()
    assert completeness.measure_residual_share(cause) <= completeness.GOAL


@pytest.mark.long
@pytest.mark.parametrize("cause", quick_cases(["thermal_bias", "thermal_scale"], ["thermal_scale"]))
def test_a_thermal_term_explains_its_effect_at_varying_room_temperature(cause: str) -> None:
    completeness = _load_completeness()
    assert completeness.measure_residual_share(cause, soak_k=SOAK_K) <= completeness.GOAL
