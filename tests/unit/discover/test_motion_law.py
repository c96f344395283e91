"""Causes that change the motion law, fitted with the position replies under that law."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import fit_base_model
from tests.support.quick_cases import quick_cases
from tests.unit.discover.conftest import ROOT

from gyrorig_protocol.identity import BoardId
from gyrorig_solver.discover import explain_fit
from gyrorig_solver.discover.extended_fit import extend_fit
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.score_tests import ScoreTest
from gyrorig_solver.estimate import (
    ConvergedFit,
    NuisanceProjector,
    fit_boards_jointly,
    free_term,
    refit_with_terms,
)
from gyrorig_solver.estimate.board_fit import BoardFit
from gyrorig_solver.estimate.executed_motion import law_columns
from gyrorig_solver.estimate.fit_segments import negative_log_likelihood
from gyrorig_solver.estimate.information import RecordingEquations
from gyrorig_solver.estimate.likelihood_fit import LikelihoodFit
from gyrorig_solver.estimate.trust_region import ProposedStep
from gyrorig_solver.model import find_term
from gyrorig_solver.numerics import chi2_upper_tail

SEEDS = quick_cases((1, 2, 3), [1])
FAR = 3.0  # standard deviations
BASE_SPEED_RAD_S = math.radians(3.5)
MAX_GAIN_NATS = 6.0  # of a cause that is not there
CHANCE = 1e-4  # of a rig in which nothing is hidden
LAW_CAUSES = ("base_speed_jump", "acceleration_error", "s_curve")


@pytest.fixture(scope="module")
def without_base_speed(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A program that sets the smallest base speed that a unit takes, one step per second."""
    path = tmp_path_factory.mktemp("program") / "no-base-speed.yaml"
    quick = (ROOT / "config" / "programs" / "quick.yaml").read_text(encoding="utf-8")
    path.write_text(quick.replace("base_speed_deg_s: 3.0", "base_speed_deg_s: 0.0515"))
    return str(path.with_suffix(""))


def base_fit(session: Any) -> ConvergedFit:
    return fit_base_model([session.recording], session.board)


def with_cause(base: ConvergedFit, cause: str) -> ConvergedFit:
    return refit_with_terms(base, [*base.fitted_terms, free_term(find_term(cause))])


def cause_sigmas(solution: ConvergedFit, truth: float) -> np.ndarray:
    """Return the errors of the cause's values in their standard uncertainties."""
    count = solution.fitted_terms[-1].free_indices.size
    std = np.sqrt(np.diag(solution.observability.covariance)[-count:])
    return np.asarray((solution.estimate[-count:] - truth) / std)


def base_sigmas(solution: ConvergedFit, board: dict[str, Any]) -> np.ndarray:
    """Return the errors of gain and time offset in their standard uncertainties."""
    offset_s = board["tau_s"] + math.sqrt(2.0) / (2.0 * math.pi * board["low_pass"]["cutoff_hz"])
    std = np.sqrt(np.diag(solution.observability.covariance))
    gain = (solution.gain - np.array(board["STM"])).ravel() / std[:9]
    return np.append(gain, (solution.estimate[12] - offset_s) / std[12])


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
def test_a_base_speed_that_was_not_set(
    hidden: Callable[..., Any], without_base_speed: str, seed: int
) -> None:
    session = hidden(f"base_speed_jump:{BASE_SPEED_RAD_S}", seed=seed, program=without_base_speed)
    solution = with_cause(base_fit(session), "base_speed_jump")
    assert solution.converged
    assert np.abs(cause_sigmas(solution, BASE_SPEED_RAD_S)).max() < FAR
    assert np.abs(base_sigmas(solution, session.boards[session.board])).max() < FAR


@pytest.mark.long
@pytest.mark.parametrize("seed", quick_cases((1, 2), [1]))
def test_the_search_judges_a_law_under_that_law(
    hidden: Callable[..., Any], without_base_speed: str, seed: int
) -> None:
    """In the samples alone, backlash of pan and tilt is like the moves of another base speed."""
    session = hidden(f"base_speed_jump:{BASE_SPEED_RAD_S}", seed=seed, program=without_base_speed)
    base = base_fit(session)
    explanation = explain_fit(base, session.board)
    (named,) = explanation.findings.causes
    assert named.term.cause == "base_speed_jump"
    assert named.one_of == ()
    errors = [(value.value - BASE_SPEED_RAD_S) / value.std for value in named.values]
    assert np.abs(errors).max() < FAR
    # A direct fit of the true model has no more likelihood.
    space, answer = MotionFitSpace(base), MotionFitSpace(explanation.solution_extended)
    true = extend_fit(space, free_term(find_term("base_speed_jump")))
    assert true.convergence.converged
    likelihoods = true.log_likelihoods([answer, true])
    assert likelihoods[0] == pytest.approx(likelihoods[1], abs=2.0)


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("cause", "size"), [("acceleration_error", 0.04), ("s_curve", 0.03)])
def test_ramps_that_differ_from_the_command(
    hidden: Callable[..., Any], seed: int, cause: str, size: float
) -> None:
    session = hidden(f"{cause}:{size}", seed=seed)
    solution = with_cause(base_fit(session), cause)
    assert solution.converged
    assert np.abs(cause_sigmas(solution, size)).max() < FAR
    assert np.abs(base_sigmas(solution, session.boards[session.board])).max() < FAR


@pytest.mark.parametrize("seed", SEEDS)
def test_a_law_cause_that_is_not_there_gains_nothing(hidden: Callable[..., Any], seed: int) -> None:
    base = base_fit(hidden(seed=seed))
    cost = negative_log_likelihood(base, base.noises)
    for cause in LAW_CAUSES:
        solution = with_cause(base, cause)
        assert solution.converged, cause
        assert cost - negative_log_likelihood(solution, base.noises) < MAX_GAIN_NATS, cause
        change = (solution.estimate[:13] - base.estimate) / np.sqrt(
            np.diag(base.observability.covariance)
        )
        assert np.abs(change).max() < 1.0, cause


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
def test_two_differences_at_once(hidden: Callable[..., Any], seed: int) -> None:
    session = hidden("s_curve:0.03", "base_speed_jump:0.05", seed=seed)
    base = base_fit(session)
    causes = [free_term(find_term(cause)) for cause in ("base_speed_jump", "s_curve")]
    solution = refit_with_terms(base, [*base.fitted_terms, *causes])
    assert solution.converged
    std = np.sqrt(np.diag(solution.observability.covariance)[-4:])
    truth = np.array([0.05, 0.05, 0.03, 0.03])
    assert np.abs((solution.estimate[-4:] - truth) / std).max() < FAR
    assert np.abs(base_sigmas(solution, session.boards[session.board])).max() < FAR


def test_the_score_of_every_parameter_is_the_difference(
    hidden: Callable[..., Any], without_base_speed: str
) -> None:
    """The samples' and the replies' parts together, against the decrease of the objective."""
    session = hidden(f"base_speed_jump:{BASE_SPEED_RAD_S}", seed=1, program=without_base_speed)
    converged = with_cause(base_fit(session), "base_speed_jump")
    cause = converged.fitted_terms[-1]
    near = replace(cause, values=0.98 * cause.values)
    board = BoardFit.resumed(converged, [*converged.fitted_terms[:-1], near])
    reference = board.sessions[0].reference
    fit = LikelihoodFit([board])
    equations = RecordingEquations.of(
        board.normal_equations()[0],
        reference,
        board.parameter_count,
        law_columns(board.fitted_terms, board.layout.first_term),
    )
    local, shared = reference.information.size
    score = equations.score[local : local + board.parameter_count]
    std = np.diag(equations.matrix.shared)[: board.parameter_count] ** -0.5  # all others fixed
    still = np.zeros(local + shared)
    for k in range(board.parameter_count):
        step = 0.05 * std[k] * np.eye(board.parameter_count)[k]
        after, before = (
            fit.evaluate(ProposedStep(sign * step, (still,), 0.0, np.zeros(step.size)))
            for sign in (1.0, -1.0)
        )
        numeric = (after - before) / 0.1  # per standard deviation
        # The derivatives use a coarser grid than the samples.
        assert score[k] * std[k] == pytest.approx(numeric, rel=0.1, abs=0.1), fit.parameter_names[k]


@pytest.mark.long
def test_boards_on_one_unit_have_one_law(hidden: Callable[..., Any], tmp_path: Path) -> None:
    names = [BoardId("GY80-1"), BoardId("GY80-2")]
    config = tmp_path / "rig.yaml"
    boards = "".join(
        f"  - {{id: {name}, port: emulated, baud: 460800, format: gcb1}}\n" for name in names
    )
    config.write_text(
        "schema: gyrorig/rig/1\nrig: two\nptu: {port: emulated, baud: 115200}\n"
        f"boards:\n{boards}emulator: {{seed: 1, dialect: e46, odr_hz: 100, bandwidth_hz: 25.0}}\n",
        encoding="utf-8",
    )
    session = hidden("base_speed_jump:0.05", seed=4, config=config)
    alone: dict[str, ConvergedFit] = {
        name: with_cause(fit_base_model([session.recording], name), "base_speed_jump")
        for name in names
    }
    joint = fit_boards_jointly(alone, {"base_speed_jump"})
    assert not joint.left_out
    values = [solution.estimate[-2:] for solution in joint.solutions.values()]
    assert values[0] == pytest.approx(values[1], rel=1e-9)
    for solution in joint.solutions.values():
        assert np.abs(cause_sigmas(solution, 0.05)).max() < FAR
    stds = {
        name: np.sqrt(np.diag(solution.observability.covariance)[-2:])
        for name, solution in alone.items()
    }
    together = np.sqrt(np.diag(joint.solutions[names[0]].observability.covariance)[-2:])
    # The replies count once: two boards know less than twice the information of one.
    assert np.all(together > 0.7 * np.minimum(*stds.values()))
    assert np.all(together < 1.01 * np.minimum(*stds.values()))


def test_boards_with_other_laws_are_not_fitted_together() -> None:
    """The columns of the law tell which values a board's fit has."""
    pan_only = replace(free_term(find_term("base_speed_jump")), free_indices=np.array([0]))
    both = free_term(find_term("base_speed_jump"))
    assert law_columns([pan_only], 13).law_values.tolist() == [2]
    assert law_columns([both], 13).law_values.tolist() == [2, 3]
    assert law_columns([both], 13).parameters.tolist() == [13, 14]
    assert not law_columns([free_term(find_term("scale_cubic"))], 13).parameters.size


@pytest.mark.long
def test_two_recordings_have_one_law(hidden: Callable[..., Any]) -> None:
    cause = "acceleration_error:0.04"
    sessions = [hidden(cause, seed=1), hidden(cause, seed=1, program="survey-40")]
    base = fit_base_model([session.recording for session in sessions], sessions[0].board)
    solution = with_cause(base, "acceleration_error")
    assert solution.converged
    alone = [with_cause(base_fit(session), "acceleration_error") for session in sessions]
    both, *each = (np.diag(fit.observability.covariance)[-2:] ** -1.0 for fit in (solution, *alone))
    assert both == pytest.approx(each[0] + each[1], rel=0.05)  # of the information
    mean = sum(
        information * fit.estimate[-2:] for information, fit in zip(each, alone, strict=True)
    ) / sum(each)
    assert np.all(np.abs(solution.estimate[-2:] - mean) < 0.5 * both**-0.5)


@pytest.mark.long
def test_the_replies_at_the_slow_ends_of_moves_are_unbiased(hidden: Callable[..., Any]) -> None:
    """Near its rest, the count of a slow axis is always rounded at the same point of a step."""
    session = hidden(seed=11, program="survey-130")
    projector = NuisanceProjector.at_fit(base_fit(session))
    law = projector.law_statistics(find_term("base_speed_jump"))
    assert law is not None
    test = ScoreTest.of(law.replies)
    assert chi2_upper_tail(test.statistic, test.degrees_of_freedom) > CHANCE
