"""Rows of a bank looked at together say what each says alone."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_solver.discover import score_tests
from gyrorig_solver.discover.score_tests import ScoreTest, scan_catalogue
from gyrorig_solver.discover.template_choice import all_templates, quick_templates
from gyrorig_solver.estimate import NuisanceProjector, WhitenedSignals
from gyrorig_solver.model.catalogue import catalogue

CAUSES = ("backlash", "clock_step", "warm_up", "saturation", "low_pass_lag")


@pytest.fixture(scope="module")
def projection(hidden: Callable[..., Any]) -> NuisanceProjector:
    """Beside the fit of a session with nothing hidden."""
    session = hidden(seed=7)
    return NuisanceProjector.at_fit(fit_base_model([session.recording], session.board))


@pytest.mark.parametrize("cause", CAUSES)
def test_rows_together_are_rows_one_by_one(projection: NuisanceProjector, cause: str) -> None:
    term = catalogue()[cause]
    rows, _ = quick_templates(projection, term)
    together = {s.place: s for s in scan_catalogue(projection, [term], 40, (rows, len(rows)))}
    apart = [
        {s.place: s for s in scan_catalogue(projection, [term], 40, (row[None], 1))} for row in rows
    ]
    for place, sight in together.items():
        most = max(scores[place].score_test.statistic for scores in apart if place in scores)
        assert sight.score_test.statistic == pytest.approx(most, rel=1e-6)
        assert len(sight.detectable_sizes) == len(rows)


@pytest.mark.parametrize("cause", ["lost_steps", "supply_hum", "clock_sawtooth"])
def test_templates_that_were_scanned_count_although_few_are_tested(
    projection: NuisanceProjector, cause: str
) -> None:
    """Both scans take pulses, lines or lags at the peaks of the residual, out of the same."""
    term = catalogue()[cause]
    quick = scan_catalogue(projection, [term], 40)
    every = scan_catalogue(projection, [term], 40, all_templates(projection, term))
    assert [score.effective_trials for score in every] == [s.effective_trials for s in quick]
    assert min(score.effective_trials for score in every) > 100.0


@pytest.mark.parametrize("cause", CAUSES)
def test_memory_that_is_short_changes_nothing(
    projection: NuisanceProjector, cause: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    term = catalogue()[cause]
    before = scan_catalogue(projection, [term], 40)
    monkeypatch.setattr(score_tests, "MAX_SIGNAL_VALUES", 1)
    after = scan_catalogue(projection, [term], 40)
    for first, other in zip(before, after, strict=True):
        assert (first.place, first.template.tolist()) == (other.place, other.template.tolist())
        assert first.score_test.statistic == pytest.approx(other.score_test.statistic, rel=1e-6)
        assert first.effective_trials == pytest.approx(other.effective_trials, rel=1e-6)
        mine = np.array([shown.detectable for shown in first.detectable_sizes])
        assert [shown.detectable for shown in other.detectable_sizes] == pytest.approx(
            mine, rel=1e-5
        )


def test_a_single_signal_is_judged_as_one_of_several(projection: NuisanceProjector) -> None:
    signals = np.random.default_rng(8).standard_normal((2, projection.residual.size))
    looked = projection.score_statistics(
        WhitenedSignals.of_dense(signals, projection.channel_lengths)
    )
    score_test = ScoreTest.of(looked.subset([0]))
    energy, score = looked.information[0, 0], looked.score[0]
    assert score_test.statistic == pytest.approx(score**2 / energy)
    assert score_test.one_step_sizes == pytest.approx([score / energy])
    assert score_test.degrees_of_freedom == 1
