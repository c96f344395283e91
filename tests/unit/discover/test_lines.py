"""A line is named from three waves on: less of one is a drift, whatever made it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from gyrorig_solver.discover.banks import all_rows
from gyrorig_solver.discover.refit import refit
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.catalogue import catalogue
from gyrorig_solver.model.terms.supply_hum import FEWEST_WAVES, waves
from gyrorig_solver.on_unit import unit_solution

HUM = catalogue()["supply_hum"]
FREQUENCY = 6


@pytest.mark.parametrize(
    ("frequency_hz", "shown"),
    [(50.0, 2000.0), (99.9, 4.0), (100.0, 0.0), (100.125, 5.0), (120.0, 800.0), (49.0, 1960.0)],
)
def test_waves_are_counted_where_sampling_folds_them_to(frequency_hz: float, shown: float) -> None:
    """100 samples a second for 40 s: above 50 Hz a line runs backwards from 100 Hz."""
    assert waves(np.array([frequency_hz]), 100.0, 40.0) == pytest.approx(shown)


@pytest.fixture(scope="module")
def drifting(hidden: Callable[..., Any]) -> Projection:
    session = hidden("bias_ramp:0.0003", program="survey-40")
    return Projection.of(unit_solution([session.recording], session.board))


def test_none_is_looked_for_where_it_would_be_a_drift(drifting: Projection) -> None:
    rows = all_rows(drifting, HUM)
    assert rows.size
    (scene,) = drifting.scenes
    length_s = scene.setting.end_s - scene.setting.begin_s
    rate_hz = drifting.stretches[0].noise.sampling.rate_hz
    assert np.all(waves(rows[:, FREQUENCY], rate_hz, length_s) > 0.9 * FEWEST_WAVES)


def test_a_drift_is_no_line_however_well_one_fits(drifting: Projection) -> None:
    rate_hz = drifting.stretches[0].noise.sampling.rate_hz
    row = np.array([*[0.0] * FREQUENCY, rate_hz + 0.01])
    one = refit(drifting, HUM, None, [row])
    assert one is not None
    assert one.won > 20.0  # half a wave follows a ramp
    assert one.impossible
