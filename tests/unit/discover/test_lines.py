"""A line is named from three waves on: less of one is a drift, whatever made it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_solver.discover.exact_fit import fit_candidate
from gyrorig_solver.discover.template_choice import MIN_PERIODS, all_templates, folded_periods
from gyrorig_solver.estimate import NuisanceProjector
from gyrorig_solver.model.catalogue import catalogue

HUM = catalogue()["supply_hum"]
FREQUENCY = 6


@pytest.mark.parametrize(
    ("frequency_hz", "shown"),
    [(50.0, 2000.0), (99.9, 4.0), (100.0, 0.0), (100.125, 5.0), (120.0, 800.0), (49.0, 1960.0)],
)
def test_waves_are_counted_where_sampling_folds_them_to(frequency_hz: float, shown: float) -> None:
    """100 samples a second for 40 s: above 50 Hz a line runs backwards from 100 Hz."""
    assert folded_periods(np.array([frequency_hz]), 100.0, 40.0) == pytest.approx(shown)


@pytest.fixture(scope="module")
def drifting(hidden: Callable[..., Any]) -> NuisanceProjector:
    session = hidden("bias_ramp:0.0003", program="survey-40")
    return NuisanceProjector.at_fit(fit_base_model([session.recording], session.board))


@pytest.mark.long
def test_none_is_looked_for_where_it_would_be_a_drift(drifting: NuisanceProjector) -> None:
    rows, _ = all_templates(drifting, HUM)
    assert rows.size
    (scene,) = drifting.states
    length_s = scene.context.end_s - scene.context.begin_s
    rate_hz = drifting.segments[0].noise.sampling.rate_hz
    assert np.all(folded_periods(rows[:, FREQUENCY], rate_hz, length_s) > 0.9 * MIN_PERIODS)


def test_a_drift_is_no_line_however_well_one_fits(drifting: NuisanceProjector) -> None:
    rate_hz = drifting.segments[0].noise.sampling.rate_hz
    row = np.array([*[0.0] * FREQUENCY, rate_hz + 0.01])
    candidate = fit_candidate(drifting, HUM, None, [row])
    assert candidate is not None
    assert candidate.delta_log_likelihood > 20.0  # half a wave follows a ramp
    assert candidate.infeasible
