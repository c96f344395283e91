"""The values of a fit, made into a twin, give the rates of the truth."""

import pytest
from tests.hidden.twin_of_fit import share_of

pytestmark = pytest.mark.long

LARGEST_SHARE = 0.005  # of the effect


@pytest.mark.parametrize(
    "hidden",
    ["scale_quadratic", "supply_hum", "clock_skew", "board_slip", "g_sensitivity", "warm_up",
     "axis_nonorthogonality", "backlash@tilt"],
)  # fmt: skip
def test_the_twin_of_a_fit_has_the_effect_of_the_truth(hidden: str) -> None:
    assert share_of(hidden).share < LARGEST_SHARE
