"""Every cause in the sensor and its clock: its term takes the whole of its effect.

Without noise nothing but what a term lacks is left; the thermal ones with a room that warms
up and cools down, for a board's own warmth moves by 0.2 K in a short session only.
"""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest
from tests.support.quick_cases import quick_cases


def _scorer() -> ModuleType:
    """Return the scorer's module; the tests' folders are no package."""
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


@pytest.mark.parametrize("cause", quick_cases(CAUSES, QUICK))
def test_a_term_leaves_nothing_of_its_own_effect(cause: str) -> None:
    scorer = _scorer()
    assert scorer.left_share(cause) <= scorer.GOAL


@pytest.mark.long
@pytest.mark.parametrize("cause", quick_cases(["thermal_bias", "thermal_scale"], ["thermal_scale"]))
def test_nor_do_the_thermal_ones_in_a_room_that_swings(cause: str) -> None:
    scorer = _scorer()
    assert scorer.left_share(cause, soak_k=SOAK_K) <= scorer.GOAL
