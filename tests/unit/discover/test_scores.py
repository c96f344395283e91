"""Rows of a bank looked at together say what each says alone."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from gyrorig_solver.discover import scores
from gyrorig_solver.discover.banks import quick_rows
from gyrorig_solver.discover.scores import Seen, sights
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.catalogue import catalogue
from gyrorig_solver.on_unit import unit_solution

CAUSES = ("backlash", "clock_step", "warm_up", "saturation", "low_pass_lag")


@pytest.fixture(scope="module")
def projection(hidden: Callable[..., Any]) -> Projection:
    """Beside the fit of a session with nothing hidden."""
    session = hidden(seed=7)
    return Projection.of(unit_solution([session.recording], session.board))


@pytest.mark.parametrize("cause", CAUSES)
def test_rows_together_are_rows_one_by_one(projection: Projection, cause: str) -> None:
    term = catalogue()[cause]
    rows, _ = quick_rows(projection, term)
    together = {s.place: s for s in sights(projection, [term], 40, rows)}
    apart = [{s.place: s for s in sights(projection, [term], 40, row[None])} for row in rows]
    for place, sight in together.items():
        most = max(one[place].seen.statistic for one in apart if place in one)
        assert sight.seen.statistic == pytest.approx(most, rel=1e-6)
        assert len(sight.shown) == len(rows)


@pytest.mark.parametrize("cause", CAUSES)
def test_memory_that_is_short_changes_nothing(
    projection: Projection, cause: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    term = catalogue()[cause]
    before = sights(projection, [term], 40)
    monkeypatch.setattr(scores, "MOST_VALUES", 1)
    after = sights(projection, [term], 40)
    for one, other in zip(before, after, strict=True):
        assert (one.place, one.row.tolist()) == (other.place, other.row.tolist())
        assert one.seen.statistic == pytest.approx(other.seen.statistic, rel=1e-6)
        assert one.looks == pytest.approx(other.looks, rel=1e-6)
        mine = np.array([shown.detectable for shown in one.shown])
        assert [shown.detectable for shown in other.shown] == pytest.approx(mine, rel=1e-5)


def test_a_single_signal_is_judged_as_one_of_several(projection: Projection) -> None:
    signals = np.random.default_rng(8).standard_normal((2, projection.residual.size))
    looked = projection.look(signals)
    one = Seen.of(looked.part([0]))
    energy, score = looked.information[0, 0], looked.score[0]
    assert one.statistic == pytest.approx(score**2 / energy)
    assert one.values == pytest.approx([score / energy])
    assert one.degrees_of_freedom == 1
