"""What the finder says of sessions with something hidden in them, and of those with nothing.

The authority is the emulated rig, which knows what it hides. The first tier only: a cause
of each kind of effect, a few sessions without any, one finder that was made worse.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from gyrorig_solver.discover import search
from gyrorig_solver.discover.finder import explain
from gyrorig_solver.discover.result import Explained
from gyrorig_solver.estimate.projection import Looked, Projection

FAR = 4.0  # standard deviations: one in 16 000


@pytest.fixture(scope="module")
def found(hidden: Callable[..., Any]) -> Callable[..., Explained]:
    """Return a function that explains a session, once each."""
    made: dict[tuple[object, ...], Explained] = {}

    def look(*hide: str, seed: int = 7) -> Explained:
        if (*hide, seed) not in made:
            session = hidden(*hide, seed=seed)
            made[(*hide, seed)] = explain([session.recording], session.board)
        return made[(*hide, seed)]

    return look


@pytest.mark.parametrize("seed", [7, 8])
def test_nothing_is_found_where_there_is_nothing(
    found: Callable[..., Explained], seed: int
) -> None:
    findings = found(seed=seed).findings
    assert findings.verdict == "adequate"
    assert findings.causes == ()
    assert findings.unexplained is None
    assert findings.gain is None


def test_it_says_what_could_be_there_unseen(found: Callable[..., Explained]) -> None:
    findings = found(seed=7).findings
    sizes = {one.cause: one for one in findings.absent}
    # The axes' squareness is all but taken by the mount: it does the most harm unseen.
    assert sizes["axis_nonorthogonality"].harm_sigma > sizes["worm_error"].harm_sigma
    harms = [one.harm_sigma for one in findings.absent]
    assert harms == sorted(harms, reverse=True)
    untestable = {one.cause for one in findings.not_testable}
    assert "lost_steps" not in untestable  # each axis moves in some of the moves
    assert {"tilt_zero", "wrong_full_scale", "earth_rotation"} <= untestable


@pytest.mark.parametrize(
    ("hide", "where"),
    [
        ("backlash@tilt:0.0012", {"tilt"}),
        ("scale_quadratic:0.004", {"x", "y", "z"}),
        ("board_slip:0.012", {"x", "y", "z"}),
    ],
)
def test_a_hidden_cause_is_named(
    found: Callable[..., Explained], hide: str, where: set[str]
) -> None:
    cause = hide.partition("@")[0].partition(":")[0]
    findings = found(hide).findings
    assert findings.verdict == "explained"
    (named,) = findings.causes
    assert named.candidates == (cause,)
    assert set(named.where) <= where
    assert named.p_value < 1e-6
    assert findings.gain is not None
    assert findings.gain.log_likelihood.value > 20.0
    assert findings.gain.rms_after < findings.gain.rms_before
    assert findings.extended_reduced_chi2 == pytest.approx(1.0, abs=0.05)


def test_the_size_is_the_truth_within_its_uncertainty(
    found: Callable[..., Explained], hidden: Callable[..., Any]
) -> None:
    (named,) = found("backlash@tilt:0.0012").findings.causes
    (truth,) = hidden("backlash@tilt:0.0012").truth
    gap = {value.name: value for value in named.values}["gap.tilt"]
    assert gap.value == pytest.approx(truth["size"]["value"], abs=FAR * gap.std)


def test_what_is_hidden_most_needs_the_projection(
    hidden: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A finder that does not take out what the base model follows names something else.

    The gain takes all but a hundredth of what axes out of square do.
    """
    session = hidden("axis_nonorthogonality:0.02")

    def named() -> list[str]:
        causes = explain([session.recording], session.board).findings.causes
        return [cause.term.cause for cause in causes]

    assert named() == ["axis_nonorthogonality"]

    def bare(projection: Projection, white: np.ndarray) -> Looked:
        gram = white @ white.T
        return Looked(gram, white @ projection.residual, np.diag(gram), np.zeros((len(white), 13)))

    monkeypatch.setattr(Projection, "look", bare)
    monkeypatch.setattr(search, "MOST_CAUSES", 1)
    assert "axis_nonorthogonality" not in named()


def test_a_finder_that_names_the_best_score_is_caught(
    hidden: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a level to pass, noise gets a name."""
    session = hidden(seed=7)
    monkeypatch.setattr(search, "ALPHA", np.inf)
    monkeypatch.setattr(search, "MOST_CAUSES", 1)
    assert explain([session.recording], session.board).findings.causes
