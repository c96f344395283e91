"""The bench's statistics on planted errors, its unit's answers, and single runs end to end."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2
from tests.bench.accuracy import goals
from tests.bench.accuracy.board import NAMES
from tests.bench.accuracy.figures import (
    covered_together,
    efficiency,
    gather,
    members,
    paired_efficiency,
)
from tests.bench.accuracy.profile import RAD_PER_STEP
from tests.bench.accuracy.summary import judged, outlier_cost, summarise
from tests.bench.accuracy.trial import PROGRAMS, Case, run
from tests.bench.accuracy.unit import COUNTER_HZ, carry_out

from gyrorig_protocol.program import parse_program

RUNS = 400


def planted(worse: float = 0.0, claimed: float = 1.0, seed: int = 0) -> list[dict[str, Any]]:
    """Runs of an estimator that adds `worse` bounds of error of its own and claims so many."""
    rng = np.random.default_rng(seed)
    rows = []
    for number in range(RUNS):
        bound = np.array([1e-4] * 12 + [1e-5])
        best = bound * rng.normal(size=13)
        error = best + worse * bound * rng.normal(size=13)
        std = claimed * bound
        rows.append(
            {
                "seed": number,
                "error": error.tolist(),
                "std": std.tolist(),
                "bound": bound.tolist(),
                "best": best.tolist(),
                "chi2": float(np.sum((error / std) ** 2)),
                "best_chi2": float(np.sum((best / bound) ** 2)),
                "shown": 13,
                "bias_at_begin": error[:3].tolist(),
                "common_s": 0.0,
                "common_std_s": 0.0,
                "stated_common_s": 0.0,
                "duration_s": 75.0,
            }
        )
    return rows


def test_efficiency_is_bound_over_deviation() -> None:
    runs = gather(planted(worse=0.75))
    for k in range(len(NAMES)):
        raw, paired = efficiency(runs, k), paired_efficiency(runs, k)
        assert raw.value == pytest.approx(0.8, rel=0.1)
        assert paired.value == pytest.approx(0.8, rel=0.08)
        assert raw.low < raw.value < raw.high


def test_pairs_know_a_small_loss_better() -> None:
    """A loss of 2 %: the pair sees it; the plain figure's own scatter is larger than that."""
    runs = gather(planted(worse=0.2))
    paired, raw = paired_efficiency(runs, 4), efficiency(runs, 4)
    assert paired.value == pytest.approx(1.0 / np.sqrt(1.04), abs=0.025)
    assert paired.high - paired.low < 0.7 * (raw.high - raw.low)


def test_coverage_follows_what_is_claimed() -> None:
    for claimed, share in ((1.0, 0.9500), (2.0, 0.9999), (0.5, 0.6729)):
        figure = covered_together(gather(planted(claimed=claimed)), members("scale"), 1.959964)
        assert figure.value == pytest.approx(share, abs=0.025)


def verdicts(rows: list[dict[str, Any]]) -> dict[str, str]:
    results = {"cases": {goals.CASES[0].name: summarise(rows)}, "outliers": {}}
    return {row.item.partition(": ")[2]: row.verdict for row in judged(results)}


def test_an_honest_best_estimate_meets_the_goals() -> None:
    by_quantity = verdicts(planted())
    assert "NO" not in by_quantity.values()
    assert by_quantity["efficiency, scale, the worst axis"] == "yes"
    assert by_quantity["joint chi-squared of 13"] == "yes"


def test_loss_and_overconfidence_are_named() -> None:
    lossy = verdicts(planted(worse=0.6, claimed=float(np.sqrt(1.36))))
    assert lossy["efficiency, bias, the worst axis"] == "NO"
    assert lossy["time offset, std / bound"] in ("NO", "no, within chance")
    assert lossy["joint chi-squared of 13"] == "yes"
    proud = verdicts(planted(claimed=0.8))
    assert proud["efficiency, bias, the worst axis"] == "yes"
    assert proud["95 % intervals, all"] == "NO"
    assert proud["joint chi-squared of 13"] == "NO"


def test_outliers_cost_what_the_pairs_say() -> None:
    clean, hit = planted(), planted(worse=0.5)
    cost = outlier_cost(clean, hit)
    assert cost["all"]["value"] == pytest.approx(1.0 / np.sqrt(1.25), abs=0.02)
    assert outlier_cost(clean, clean)["scale"]["value"] == 1.0


@pytest.mark.parametrize(("baud", "counter"), [(9600.0, False), (115_200.0, True)])
def test_the_unit_answers_what_it_may(baud: float, counter: bool) -> None:
    """Counts at rest are the targets', instants lie in their windows, bytes take their time."""
    program = parse_program((PROGRAMS / "quick.yaml").read_text(encoding="utf-8"), "quick")
    session = carry_out(program, baud, np.random.default_rng(8), counter)
    answers, path = session.answers, session.path
    assert np.all(answers.instant_s >= answers.lo_s)
    assert np.all(answers.instant_s <= answers.hi_s)
    for axis in (0, 1):
        is_axis = answers.axis == axis
        moves = path.of_axis(axis)
        after = answers.instant_s[is_axis] > moves[-1].end_s
        assert np.all(answers.steps[is_axis][after] == moves[-1].end_steps)
        off = answers.steps[is_axis] - path.counted_steps(axis, answers.instant_s[is_axis])
        assert np.abs(off).max() <= 1.0
        angle = path.angle_rad(axis, answers.instant_s[is_axis]) / RAD_PER_STEP
        assert np.abs(answers.steps[is_axis] - angle).max() < 1.6  # a step and detents of 0.1
    apart = np.diff(np.unique(answers.lo_s))
    wire_s = (3 + (44 if counter else 9)) * 10.0 / baud
    assert apart.min() >= max(0.010, wire_s + session.least_s)
    if answers.ticks is not None:
        gone = np.diff(answers.ticks[::2]) % 2**32 / COUNTER_HZ
        assert np.allclose(gone, np.diff(answers.instant_s[::2]), rtol=3e-5, atol=3e-8)


@pytest.mark.parametrize(
    "case",
    [
        Case("known", "quick.yaml", number=90),
        Case("answers", "quick.yaml", baud=115_200.0, number=90),
        Case("counter", "quick.yaml", baud=9600.0, counter=True, number=90),
        Case("spikes", "quick.yaml", spikes=0.01, number=90),
    ],
    ids=lambda case: case.name,
)
def test_runs_err_as_the_best_estimate_does(case: Case) -> None:
    """Two runs each: near the best estimate of the same noise, joint chi-squared in its span."""
    low, high = (float(chi2.ppf(share, 2 * 13)) for share in (1e-4, 1.0 - 1e-4))
    total = 0.0
    for seed in range(2):
        trial_run = run(case, seed)
        assert trial_run["shown"] == 13
        total += trial_run["chi2"]
        apart = (np.array(trial_run["error"]) - trial_run["best"]) / trial_run["bound"]
        assert np.abs(apart).max() < 1.5
    assert low < total < high
