"""Causes that are the unit's, fitted to all boards at one size: the same as one large fit."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import kstest
from tests.unit.solver.made import reference_of, samples_of

from gyrorig_solver.estimate.extension import Extension, Told, fitted
from gyrorig_solver.estimate.information import Marginal
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.estimate.motion import solution_of
from gyrorig_solver.estimate.on_one_unit import fit_on_one_unit
from gyrorig_solver.estimate.ties import disagreement, is_of_unit, same_values, tied
from gyrorig_solver.estimate.whitening import OWN
from gyrorig_solver.model.terms.catalogue import term

Simulate = Callable[..., Any]
NOISE_RAD_S = 2.5e-3
CAUSE = "axis_nonorthogonality"
BOARDS = 3


@pytest.fixture(scope="module")
def rig(simulate: Simulate) -> Any:
    """A motion as a board without noise sees it, at tilts far apart."""
    return simulate(42, tilts=(-900, 600, 0, 800), noise=0.0)


def board(rig: Any, number: int, causes: tuple[Extension, ...]) -> Solution:
    rng = np.random.default_rng([19, number])
    gain = np.eye(3) + rng.normal(scale=0.02, size=(3, 3))
    rate = (rig.rate_rad_s - rig.bias_rad_s) @ (gain @ np.linalg.inv(rig.gain)).T
    rate = rate + rng.normal(scale=0.05, size=3) + rng.normal(scale=NOISE_RAD_S, size=rate.shape)
    return solution_of([(samples_of(rig.time_s, rate), reference_of(rig))], causes)


@pytest.fixture(scope="module")
def alone(rig: Any) -> dict[str, Solution]:
    return {f"B{n}": board(rig, n, (fitted(term(CAUSE)),)) for n in range(BOARDS)}


@pytest.fixture(scope="module")
def joint(alone: dict[str, Solution]) -> dict[str, Solution]:
    found = fit_on_one_unit(alone, [CAUSE])
    assert not found.left_out
    return dict(found.solutions)


def test_all_boards_have_one_size_and_know_it_better(
    alone: dict[str, Solution], joint: dict[str, Solution]
) -> None:
    values = [one.estimate[-1] for one in joint.values()]
    assert np.ptp(values) < 1e-12
    stds = [np.sqrt(one.decision.covariance[-1, -1]) for one in joint.values()]
    assert stds == pytest.approx([stds[0]] * BOARDS, rel=1e-6)
    before = [np.sqrt(one.decision.covariance[-1, -1]) for one in alone.values()]
    # What each knows of its own adds up, but for the motion's errors that all of them share.
    assert stds[0] < 0.8 * min(before)
    assert abs(values[0]) < 4.0 * stds[0]  # there is none


def test_it_is_the_fit_of_everything_at_once(joint: dict[str, Solution]) -> None:
    """Against a dense matrix over all unknowns, the cause once, nothing eliminated by blocks."""
    solutions = list(joint.values())
    known = solutions[0].sessions[0].reference.information
    local, shared = known.size
    first = local + BOARDS * OWN
    total = first + shared + 1
    dense = np.zeros((total, total))
    unit = np.concatenate([np.arange(local), np.arange(first, first + shared)])
    dense[np.ix_(unit, unit)] += known.to_dense()
    places = []
    for n, one in enumerate(solutions):
        matrix = one.sessions[0].normal(one.gain, one.noises[0]).matrix
        acting = matrix.size[1] - OWN - 1
        own = local + n * OWN + np.arange(OWN)
        at = np.concatenate([np.arange(local), own, [total - 1], first + np.arange(acting)])
        dense[np.ix_(at, at)] += matrix.to_dense()
        places.append(np.concatenate([own, [total - 1]]))
    covariance = np.linalg.inv(dense)
    for at, one in zip(places, solutions, strict=True):
        expected = covariance[np.ix_(at, at)].copy()
        expected[12, 12] += one.sessions[0].common_std_s ** 2  # a shift that nothing shows
        scale = np.sqrt(np.diag(expected))
        difference = (one.decision.covariance - expected) / np.outer(scale, scale)
        assert np.abs(difference).max() < 2e-3


def test_a_cause_that_is_not_common_stays_each_boards_own(alone: dict[str, Solution]) -> None:
    found = fit_on_one_unit(alone)
    assert not found.left_out
    values = [one.estimate[-1] for one in found.solutions.values()]
    assert np.ptp(values) > 0.0
    stds = [np.sqrt(one.decision.covariance[-1, -1]) for one in found.solutions.values()]
    before = [np.sqrt(one.decision.covariance[-1, -1]) for one in alone.values()]
    assert stds == pytest.approx(before, rel=0.1)


def drawn(rng: np.random.Generator, shift: float = 0.0) -> tuple[Marginal, np.ndarray]:
    """A board's information and a score that chance gives it, the cause's value `shift` off."""
    rows = rng.normal(size=(60, OWN + 2)) * np.logspace(0.0, 4.0, OWN + 2)
    information = rows.T @ rows
    at = np.zeros(OWN + 2)
    at[-1] = shift / np.sqrt(1.0 / np.linalg.inv(information)[-1, -1])
    score = rows.T @ rng.normal(size=60) + information @ at
    empty = np.zeros((0, OWN + 3))
    return Marginal(information, score, empty, empty), np.logspace(0.0, -4.0, OWN + 2)


def test_boards_that_agree_do_so_by_chance() -> None:
    """The p value of a fair board is uniform (Kolmogorov and Smirnov); one far off is found."""
    rng = np.random.default_rng(5)
    common = np.arange(OWN + 2) >= OWN
    fair = [disagreement([one], units, common) for one, units in (drawn(rng) for _ in range(300))]
    assert kstest(fair, "uniform").pvalue > 1e-3
    far = [drawn(rng, shift=9.0) for _ in range(20)]
    assert max(disagreement([one], units, common) for one, units in far) < 1e-6
    assert disagreement([far[0][0]], far[0][1], np.zeros(OWN + 2, dtype=np.bool_)) == 1.0


def test_only_causes_that_are_alike_are_tied(alone: dict[str, Solution]) -> None:
    one, two = list(alone.values())[:2]
    width = one.estimate.size
    causes = same_values([one, two], [CAUSE])
    both = tied(causes, [width, width], [CAUSE])
    assert both.size == 2 * width - 1
    assert both.of[width - 1] == both.of[-1]
    assert both.common.sum() == 2
    other = replace(causes[1][0], free=causes[1][0].free[:0])  # of a known size there
    apart = tied([causes[0], [other]], [width, width - 1], [CAUSE])
    assert apart.size == 2 * width - 1
    # One that a board was told of by others is told no more.
    told = Told(np.array([1e-3]), np.array([[1e6]]))
    known = replace(one, extensions=(replace(one.extensions[0], told=told),))
    assert same_values([known, two], [CAUSE])[0][0].told is None
    assert same_values([known, two], [])[0][0].told is told


def test_whose_a_cause_is_by_its_kind() -> None:
    assert is_of_unit(term("s_curve"))
    assert is_of_unit(term("worm_error"))
    assert not is_of_unit(term("g_sensitivity"))
