"""Causes that are the unit's, fitted to all boards at one size: the same as one large fit."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import kstest
from tests.unit.solver.made import reference_of, samples_of

from gyrorig_solver.estimate import (
    BASE_PARAMETERS,
    ConvergedFit,
    FittedTerm,
    GaussianPrior,
    ParameterLayout,
    fit_boards_jointly,
    free_term,
    is_unit_cause,
)
from gyrorig_solver.estimate.derivative_cache import DerivativeCache
from gyrorig_solver.estimate.information import MarginalEquations
from gyrorig_solver.estimate.motion_fit import solve_motion
from gyrorig_solver.estimate.shared_parameters import average_shared_values, shared_term_p_value
from gyrorig_solver.model import find_term

Simulate = Callable[..., Any]
NOISE_RAD_S = 2.5e-3
CAUSE = "axis_nonorthogonality"
BOARDS = 3


@pytest.fixture(scope="module")
def rig(simulate: Simulate) -> Any:
    """A motion as a board without noise sees it, at tilts far apart."""
    return simulate(42, tilts=(-900, 600, 0, 800), noise=0.0)


def board(rig: Any, number: int, causes: tuple[FittedTerm, ...]) -> ConvergedFit:
    rng = np.random.default_rng([19, number])
    gain = np.eye(3) + rng.normal(scale=0.02, size=(3, 3))
    rate = (rig.rate_rad_s - rig.bias_rad_s) @ (gain @ np.linalg.inv(rig.gain)).T
    rate = rate + rng.normal(scale=0.05, size=3) + rng.normal(scale=NOISE_RAD_S, size=rate.shape)
    return solve_motion([(samples_of(rig.time_s, rate), reference_of(rig))], causes)


@pytest.fixture(scope="module")
def alone(rig: Any) -> dict[str, ConvergedFit]:
    return {f"B{n}": board(rig, n, (free_term(find_term(CAUSE)),)) for n in range(BOARDS)}


@pytest.fixture(scope="module")
def joint(alone: dict[str, ConvergedFit]) -> dict[str, ConvergedFit]:
    with pytest.MonkeyPatch.context() as patch:  # keep the equations to compare with
        patch.setattr(DerivativeCache, "release_equations", lambda _: None)
        joint_fit = fit_boards_jointly(alone, [CAUSE])
    assert not joint_fit.left_out
    return dict(joint_fit.solutions)


def test_shared_cause_has_one_size_and_less_uncertainty(
    alone: dict[str, ConvergedFit], joint: dict[str, ConvergedFit]
) -> None:
    values = [solution.estimate[-1] for solution in joint.values()]
    assert np.ptp(values) < 1e-12
    stds = [np.sqrt(solution.observability.covariance[-1, -1]) for solution in joint.values()]
    assert stds == pytest.approx([stds[0]] * BOARDS, rel=1e-6)
    before = [np.sqrt(solution.observability.covariance[-1, -1]) for solution in alone.values()]
    # What each knows of its own adds up, but for the motion's errors that all of them share.
    assert stds[0] < 0.8 * min(before)
    assert abs(values[0]) < 4.0 * stds[0]  # there is none


def test_joint_fit_equals_one_large_fit(joint: dict[str, ConvergedFit]) -> None:
    """Against a dense matrix over all unknowns, the cause once, nothing eliminated by blocks."""
    solutions = list(joint.values())
    known = solutions[0].sessions[0].reference.information
    local, shared = known.size
    first = local + BOARDS * BASE_PARAMETERS
    total = first + shared + 1
    dense = np.zeros((total, total))
    unit = np.concatenate([np.arange(local), np.arange(first, first + shared)])
    dense[np.ix_(unit, unit)] += known.to_dense()
    places = []
    for n, solution in enumerate(solutions):
        matrix = solution.sessions[0].normal_equations(solution.gain, solution.noises[0]).matrix
        acting = matrix.size[1] - BASE_PARAMETERS - 1
        indices = local + n * BASE_PARAMETERS + np.arange(BASE_PARAMETERS)
        at = np.concatenate([np.arange(local), indices, [total - 1], first + np.arange(acting)])
        dense[np.ix_(at, at)] += matrix.to_dense()
        places.append(np.concatenate([indices, [total - 1]]))
    covariance = np.linalg.inv(dense)
    for at, solution in zip(places, solutions, strict=True):
        expected = covariance[np.ix_(at, at)].copy()
        expected[12, 12] += solution.sessions[0].common_std_s ** 2  # a shift that nothing shows
        scale = np.sqrt(np.diag(expected))
        difference = (solution.observability.covariance - expected) / np.outer(scale, scale)
        assert np.abs(difference).max() < 2e-3


def test_unshared_cause_stays_per_board(alone: dict[str, ConvergedFit]) -> None:
    joint_fit = fit_boards_jointly(alone)
    assert not joint_fit.left_out
    values = [solution.estimate[-1] for solution in joint_fit.solutions.values()]
    assert np.ptp(values) > 0.0
    stds = [
        np.sqrt(solution.observability.covariance[-1, -1])
        for solution in joint_fit.solutions.values()
    ]
    before = [np.sqrt(solution.observability.covariance[-1, -1]) for solution in alone.values()]
    assert stds == pytest.approx(before, rel=0.1)


def drawn(rng: np.random.Generator, shift: float = 0.0) -> tuple[MarginalEquations, np.ndarray]:
    """A board's information and a score that chance gives it, the cause's value `shift` off."""
    rows = rng.normal(size=(60, BASE_PARAMETERS + 2)) * np.logspace(0.0, 4.0, BASE_PARAMETERS + 2)
    information = rows.T @ rows
    at = np.zeros(BASE_PARAMETERS + 2)
    at[-1] = shift / np.sqrt(1.0 / np.linalg.inv(information)[-1, -1])
    score = rows.T @ rng.normal(size=60) + information @ at
    empty = np.zeros((0, BASE_PARAMETERS + 3))
    return MarginalEquations(information, score, empty, empty), np.logspace(
        0.0, -4.0, BASE_PARAMETERS + 2
    )


def test_agreeing_boards_have_uniform_p_values() -> None:
    """The p value of a fair board is uniform (Kolmogorov and Smirnov); one far off is found."""
    rng = np.random.default_rng(5)
    common = np.arange(BASE_PARAMETERS + 2) >= BASE_PARAMETERS
    fair = [
        shared_term_p_value([marginal], units, common)
        for marginal, units in (drawn(rng) for _ in range(300))
    ]
    assert kstest(fair, "uniform").pvalue > 1e-3
    far = [drawn(rng, shift=9.0) for _ in range(20)]
    assert max(shared_term_p_value([marginal], units, common) for marginal, units in far) < 1e-6
    assert (
        shared_term_p_value([far[0][0]], far[0][1], np.zeros(BASE_PARAMETERS + 2, dtype=np.bool_))
        == 1.0
    )


def test_only_equal_terms_are_shared(alone: dict[str, ConvergedFit]) -> None:
    first, two = list(alone.values())[:2]
    width = first.estimate.size
    causes = average_shared_values([first, two], [CAUSE])
    layout = ParameterLayout.of(causes, 1, [CAUSE])
    assert layout.size == 2 * width - 1
    assert layout.board_index(0)[-1] == layout.board_index(1)[-1]
    assert layout.is_shared(np.arange(layout.size)).sum() == 1
    held = replace(causes[1][0], free_indices=causes[1][0].free_indices[:0])
    separate = ParameterLayout.of([causes[0], [held]], 1, [CAUSE])
    assert separate.size == 2 * width - 1
    assert not separate.is_shared(separate.board_index(1)).any()
    # The joint fit has the other boards' data, so their prior is removed.
    prior = GaussianPrior(np.array([1e-3]), np.array([[1e6]]))
    known = replace(first, fitted_terms=(replace(first.fitted_terms[0], other_boards_prior=prior),))
    assert average_shared_values([known, two], [CAUSE])[0][0].other_boards_prior is None
    assert average_shared_values([known, two], [])[0][0].other_boards_prior is prior


def test_unit_causes_by_kind() -> None:
    assert is_unit_cause(find_term("s_curve"))
    assert is_unit_cause(find_term("worm_error"))
    assert not is_unit_cause(find_term("g_sensitivity"))
