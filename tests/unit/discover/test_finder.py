"""What the finder says of sessions with something hidden in them, and of those with nothing.

The authority is the emulated rig, which knows what it hides. The first tier only: a cause
of each kind of effect, a few sessions without any, one finder that was made worse.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import explain_recordings
from tests.support.quick_cases import quick_cases

from gyrorig_solver.discover import (
    FitExplanation,
    backward_elimination,
    candidate_fits,
    cause_search,
    motion_space,
)
from gyrorig_solver.estimate import NuisanceProjector, ScoreStatistics, WhitenedSignals
from gyrorig_solver.estimate.uncertainty_widening import reduced_chi2
from gyrorig_solver.model.catalogue import catalogue

FAR = 4.0  # standard deviations: one in 16 000


@pytest.fixture(scope="module")
def explained(hidden: Callable[..., Any]) -> Callable[..., FitExplanation]:
    """Return a function that explains a session, once each."""
    made: dict[tuple[object, ...], FitExplanation] = {}

    def look(*hide: str, seed: int = 7) -> FitExplanation:
        if (*hide, seed) not in made:
            session = hidden(*hide, seed=seed)
            made[(*hide, seed)] = explain_recordings([session.recording], session.board)
        return made[(*hide, seed)]

    return look


@pytest.mark.parametrize("seed", quick_cases([7, 8], [7]))
def test_nothing_is_found_where_there_is_nothing(
    explained: Callable[..., FitExplanation], seed: int
) -> None:
    findings = explained(seed=seed).findings
    assert findings.verdict == "adequate"
    assert findings.causes == ()
    assert findings.unexplained is None
    assert findings.gain is None


def test_it_says_what_could_be_there_unseen(explained: Callable[..., FitExplanation]) -> None:
    findings = explained(seed=7).findings
    sizes = {
        detection_limit.cause: detection_limit for detection_limit in findings.detection_limits
    }
    # The axes' squareness is all but taken by the mount: it does the most harm unseen.
    assert (
        sizes["axis_nonorthogonality"].parameter_bias_sigma
        > sizes["worm_error"].parameter_bias_sigma
    )
    harms = [detection_limit.parameter_bias_sigma for detection_limit in findings.detection_limits]
    assert harms == sorted(harms, reverse=True)
    untestable = {entry.cause for entry in findings.untestable}
    assert "lost_steps" not in untestable  # each axis moves in some of the moves
    assert {"tilt_zero", "wrong_full_scale", "earth_rotation"} <= untestable


@pytest.mark.parametrize(
    ("hide", "where"),
    quick_cases(
        [
            ("backlash@tilt:0.0012", {"tilt"}),
            ("scale_quadratic:0.004", {"x", "y", "z"}),
            ("board_slip:0.012", {"x", "y", "z"}),
        ],
        [("backlash@tilt:0.0012", {"tilt"})],
    ),
)
def test_a_hidden_cause_is_named(
    explained: Callable[..., FitExplanation], hide: str, where: set[str]
) -> None:
    cause = hide.partition("@")[0].partition(":")[0]
    explanation = explained(hide)
    findings = explanation.findings
    assert findings.verdict == "explained"
    (named,) = findings.causes
    assert named.candidates == (cause,)
    assert set(named.where) <= where
    assert named.p_value < 1e-6
    assert findings.gain is not None
    assert findings.gain.log_likelihood.value > 20.0
    assert findings.gain.rms_after < findings.gain.rms_before
    assert reduced_chi2(explanation.solution_extended) == pytest.approx(1.0, abs=0.05)


def test_a_rest_states_which_causes_it_cannot_show(hidden: Callable[..., Any]) -> None:
    """Before, causes of which the bias absorbs the whole effect were not mentioned at all."""
    session = hidden(program="static", seed=22)
    findings = explain_recordings([session.recording], session.board).findings
    untestable = {entry.cause for entry in findings.untestable}
    stated = untestable | {limit.cause for limit in findings.detection_limits}
    stated |= {named.cause for named in findings.causes}
    searched = {
        term.cause
        for term in catalogue().values()
        if term.kind in ("effect", "stochastic") and not term.first_order_equivalent
    }
    assert searched - stated == set()
    assert {"scale_cubic", "low_pass_lag", "backlash", "sample_jitter"} <= untestable


def test_the_size_is_the_truth_within_its_uncertainty(
    explained: Callable[..., FitExplanation], hidden: Callable[..., Any]
) -> None:
    (named,) = explained("backlash@tilt:0.0012").findings.causes
    (truth,) = hidden("backlash@tilt:0.0012").truth
    gap = {value.name: value for value in named.values}["gap.tilt"]
    assert gap.value == pytest.approx(truth["size"]["value"], abs=FAR * gap.std)


@pytest.mark.long
def test_what_is_hidden_most_needs_the_projection(
    hidden: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A finder that does not take out what the base model follows names something else.

    The gain takes all but a hundredth of what axes out of square do.
    """
    session = hidden("axis_nonorthogonality:0.02")

    def named() -> list[str]:
        causes = explain_recordings([session.recording], session.board).findings.causes
        return [cause.term.cause for cause in causes]

    assert named() == ["axis_nonorthogonality"]

    def bare(projection: NuisanceProjector, signals: WhitenedSignals) -> ScoreStatistics:
        white = signals.dense()
        gram = white @ white.T
        return ScoreStatistics(
            gram, white @ projection.residual, np.diag(gram), np.zeros((len(white), 13))
        )

    monkeypatch.setattr(NuisanceProjector, "score_statistics", bare)
    monkeypatch.setattr(cause_search, "MAX_CAUSES", 1)
    assert "axis_nonorthogonality" not in named()


@pytest.mark.long
def test_a_finder_that_names_the_best_score_is_caught(
    hidden: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a level to pass, noise gets a name."""
    session = hidden(seed=7)
    for module in (backward_elimination, candidate_fits, cause_search, motion_space):
        monkeypatch.setattr(module, "FALSE_ALARM_RATE", np.inf)
    monkeypatch.setattr(cause_search, "MAX_CAUSES", 1)
    assert explain_recordings([session.recording], session.board).findings.causes
