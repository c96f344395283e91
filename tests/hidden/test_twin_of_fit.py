"""The twin from the values of a fit has the rates of the truth."""

import pytest
from tests.hidden.twin_of_fit import measure_share

pytestmark = pytest.mark.long

LARGEST_SHARE = 0.005  # of the effect


@pytest.mark.parametrize(
    "hidden",
    ["scale_quadratic", "supply_hum", "clock_skew", "board_slip", "g_sensitivity", "warm_up",
     "axis_nonorthogonality", "backlash@tilt"],
)  # fmt: skip
def test_the_twin_of_a_fit_has_the_effect_of_the_truth(hidden: str) -> None:
    assert measure_share(hidden).share < LARGEST_SHARE
