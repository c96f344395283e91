"""Several boards on one unit: what is the unit's, and what is one board's.

The authority is the emulated rig: a rounded ramp is its controller's, a low-pass that is
not as configured one board's.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.discover import FitExplanation, MotionFitSpace, explain_jointly
from gyrorig_solver.discover.boards.joint_projector import (
    JointProjector,
    LocalQuadratic,
    homogeneity_p_value,
    prior_from_others,
)
from gyrorig_solver.discover.boards.scope_hypotheses import possible_owner
from gyrorig_solver.discover.cause_search import search_causes
from gyrorig_solver.discover.held_out_gain import gain_on_recording
from gyrorig_solver.estimate import ConvergedFit, NuisanceProjector, WhitenedSignals
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.pipeline import explain_boards
from gyrorig_solver.pipeline.board_results import BoardExplanation
from gyrorig_solver.pipeline.prepare_board import prepare_held_out

pytestmark = pytest.mark.long

BOARDS = ("GY80-1", "GY80-2", "GY80-3", "GY80-4")
FAR = 4.0  # standard deviations

FEW_OR_ALL = pytest.mark.parametrize(
    ("boards", "program"), [(2, "quick"), pytest.param(4, "survey-40", marks=pytest.mark.bench)]
)

Bases = Callable[..., dict[str, ConvergedFit]]


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An emulated rig with four boards."""
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    boards = "".join(
        f"  - {{id: {name}, port: emulated, baud: 460800, format: gcb1}}\n" for name in BOARDS
    )
    path.write_text(
        "schema: gyrorig/rig/1\nrig: four\nptu: {port: emulated, baud: 115200}\n"
        f"boards:\n{boards}emulator: {{seed: 1, dialect: e46, odr_hz: 100, bandwidth_hz: 25.0}}\n"
    )
    return path


@pytest.fixture(scope="module")
def bases(hidden: Callable[..., Any], config: Path) -> Bases:
    """Return a function that fits the base model to each board of a session."""

    def fit(*hide: str, boards: int = 4, program: str = "survey-40") -> dict[str, ConvergedFit]:
        session = hidden(*hide, seed=3, program=program, config=config)
        return {name: fit_base_model([session.recording], name) for name in BOARDS[:boards]}

    return fit


@pytest.fixture(scope="module")
def rounded(bases: Bases) -> dict[str, FitExplanation]:
    """Two boards on a unit that rounds its ramps."""
    return explain_jointly(bases("s_curve:0.03", boards=2, program="quick"))


def test_what_all_boards_show_is_the_units(rounded: dict[str, FitExplanation]) -> None:
    for explained in rounded.values():
        (named,) = explained.findings.causes
        assert named.candidates == ("s_curve",)
        assert named.attribution is not None
        assert named.attribution.owner == "unit"
        assert (named.attribution.detected_by, named.attribution.board_count) == (2, 2)
        assert "this is a cause of the unit, and 2 of 2 boards show it" in named.sentence
        assert named.attribution.disagreement_p is not None
        assert named.attribution.disagreement_p > 1e-4
        for value in named.values:
            assert value.value == pytest.approx(0.03, abs=FAR * value.std)


def test_a_units_cause_has_one_size_at_all_boards(rounded: dict[str, FitExplanation]) -> None:
    sizes = [
        [(v.value, v.std) for v in explanation.findings.causes[0].values]
        for explanation in rounded.values()
    ]
    for each in zip(*sizes, strict=True):
        values, stds = np.array(each).T
        assert np.ptp(values) < 0.2 * stds.min()  # each fit was told what the others know
        assert stds == pytest.approx(stds.mean(), rel=0.1)


def test_a_shared_cause_is_worth_something_on_another_recording(
    rounded: dict[str, FitExplanation], hidden: Callable[..., Any], config: Path
) -> None:
    other = hidden("s_curve:0.03", seed=3, program="survey-40", config=config)
    for name, explanation in rounded.items():
        held_out = prepare_held_out(other.recording, name, explanation.solution_extended)
        gain = gain_on_recording(explanation.solution_base, explanation.solution_extended, held_out)
        assert gain.log_likelihood.low > 0.0


def test_boards_are_put_together_by_their_recordings(
    hidden: Callable[..., Any], config: Path
) -> None:
    """A board that is not there fails for itself; the others are explained."""
    recording = hidden(seed=3, program="quick", config=config).recording
    boards = [BoardId(name) for name in (*BOARDS[:2], "nowhere")]
    explanations = dict(explain_boards({board: [recording] for board in boards}))
    assert isinstance(explanations.pop(boards[2]), InputError)
    for board, explanation in explanations.items():
        assert isinstance(explanation, BoardExplanation)
        assert explanation.board == board
        assert explanation.findings.verdict == "adequate"


@pytest.mark.parametrize("boards", [2, pytest.param(4, marks=pytest.mark.bench)])
def test_what_one_board_shows_is_its_own(bases: Bases, boards: int) -> None:
    joint_result = explain_jointly(bases("low_pass_lag@GY80-2:0.3", boards=boards))
    for name, explained in joint_result.items():
        causes = explained.findings.causes
        if name != "GY80-2":
            assert causes == ()
            continue
        (named,) = causes
        assert named.candidates == ("low_pass_lag",)
        assert named.attribution is not None
        assert named.attribution.owner == "board"
        assert named.sentence.endswith(
            "; this is a cause of this board only, because "
            + (
                "the other board does not show it"
                if boards == 2
                else "none of the other 3 boards shows it"
            )
        )


@FEW_OR_ALL
def test_boards_with_nothing_have_no_findings(bases: Bases, boards: int, program: str) -> None:
    for explained in explain_jointly(bases(boards=boards, program=program)).values():
        assert explained.findings.verdict == "adequate"


def test_whose_a_cause_can_be() -> None:
    causes = catalogue()
    assert possible_owner(causes["s_curve"]) == "unit"
    assert possible_owner(causes["lost_steps"]) == "unit"
    assert possible_owner(causes["low_pass_lag"]) == "board"
    assert possible_owner(causes["clock_skew"]) == "either"


def test_boards_side_by_side_are_one_least_squares_problem(bases: Bases) -> None:
    """Against a dense solution with one set of the motion's unknowns, put together by itself."""
    parts = [
        NuisanceProjector.at_fit(board_fit)
        for board_fit in bases(boards=2, program="quick").values()
    ]
    together = JointProjector(parts)
    rng = np.random.default_rng(5)
    signal = rng.standard_normal((2, together.residual.size))
    apart = [projector.normal_blocks() for projector in parts]
    parameter_counts = [blocks.board_derivatives.shape[0] for blocks in apart]
    common = apart[0].motion_prior_information.shape[0]
    size = sum(parameter_counts) + common
    rows, data, first = [], [], 0
    for k, (blocks, board) in enumerate(zip(apart, parts, strict=True)):
        design = np.zeros((board.residual.size, size))
        design[:, first : first + parameter_counts[k]] = blocks.board_derivatives.T
        motion = np.vstack([blocks.local_derivatives.toarray(), blocks.shared_derivatives])
        design[:, sum(parameter_counts) :] = motion.T
        rows.append(design)
        data.append(board.residual - motion.T @ blocks.motion_prior_offset)
        first += parameter_counts[k]
    known = np.zeros((size, size))
    pull, first = np.zeros(size), 0
    for k, blocks in enumerate(apart):
        at = slice(first, first + parameter_counts[k])
        known[at, at], pull[at] = blocks.board_prior_information, blocks.board_prior_score
        first += parameter_counts[k]
    known[first:, first:] = min((blocks.motion_prior_information for blocks in apart), key=np.trace)
    whole = np.vstack(rows)
    normal = whole.T @ whole + known
    scale = 1.0 / np.sqrt(np.diag(normal))
    step = scale[:, None] * np.linalg.solve(
        normal * np.outer(scale, scale), scale[:, None] * (whole.T @ signal.T)
    )
    looked = together.score_statistics(WhitenedSignals.of_dense(signal, [signal.shape[1]]))
    assert looked.information == pytest.approx(
        signal @ signal.T - signal @ whole @ step, rel=1e-6, abs=1e-3
    )
    residual = np.concatenate(data)
    score = signal @ residual - step.T @ (whole.T @ residual + pull)
    assert looked.score == pytest.approx(score, rel=1e-6, abs=1e-3)


def test_a_board_that_is_told_the_rest_ends_where_all_do() -> None:
    """Two quadratics: the sum's minimum is that of one with what it is told of the other."""
    quadratic = LocalQuadratic(np.diag([4.0, 1.0]), np.array([2.0, -1.0]), 0.0)
    two = LocalQuadratic(np.diag([1.0, 3.0]), np.array([-2.0, 1.0]), 0.0)
    both = LocalQuadratic(quadratic.information + two.information, quadratic.slope + two.slope, 0.0)
    at = np.array([0.3, 0.7])
    knows = prior_from_others(at, both, quadratic)
    # All rest at `at`: there the one's own slope and what it is told cancel.
    assert knows.score(at) == pytest.approx(-quadratic.slope)
    assert knows.information == pytest.approx(two.information)
    assert homogeneity_p_value([quadratic, quadratic]) == pytest.approx(1.0)
    assert (
        homogeneity_p_value(
            [quadratic, LocalQuadratic(two.information, -40.0 * quadratic.slope, 0.0)]
        )
        < 1e-6
    )


@pytest.mark.bench
def test_what_no_board_sees_alone_all_of_them_see(hidden: Callable[..., Any], config: Path) -> None:
    """Corners rounded over 5 ms are below what one board can be sure of in 40 s."""
    session = hidden("s_curve:0.005", seed=5, program="survey-40", config=config)
    bases = {name: fit_base_model([session.recording], name) for name in BOARDS}
    assert search_causes(MotionFitSpace(bases[BOARDS[0]])).ranked_causes == ()
    for explained in explain_jointly(bases).values():
        (named,) = explained.findings.causes
        assert named.candidates == ("s_curve",)
        assert named.attribution is not None
        assert named.attribution.owner == "unit"
        for value in named.values:
            assert value.value == pytest.approx(0.005, abs=FAR * value.std)
