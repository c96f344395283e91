"""Boards that were on one unit at once, fitted together: the same as one large fit, and fair."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.unit.solver.made import reference_of, samples_of

from gyrorig_solver.estimate import BASE_PARAMETERS, ConvergedFit, fit_boards_jointly
from gyrorig_solver.estimate.linear.normal_equations import NormalEquations, stack_boards
from gyrorig_solver.estimate.motion_fit import solve_motion
from gyrorig_solver.estimate.multi_board_fit import motion_agreement_p_value

Simulate = Callable[..., Any]
NOISE_RAD_S = 2.5e-3
BOARDS = 4


@pytest.fixture(scope="module")
def rig(simulate: Simulate) -> Any:
    """A motion as a board without noise sees it."""
    return simulate(41, tilts=(-500, 400, 0), noise=0.0)


def board(rig: Any, number: int, late_s: float = 0.0) -> tuple[np.ndarray, ConvergedFit]:
    """A board of its own gain, bias and noise on that motion, and its fit alone.

    `late_s`: how late the middle third of its samples is, as from a clock that jumps.
    """
    rng = np.random.default_rng([9, number])
    gain = np.eye(3) + rng.normal(scale=0.02, size=(3, 3))
    rate = (rig.rate_rad_s - rig.bias_rad_s) @ (gain @ np.linalg.inv(rig.gain)).T
    rate = rate + rng.normal(scale=0.05, size=3) + rng.normal(scale=NOISE_RAD_S, size=rate.shape)
    if late_s:
        third = rig.time_s.size // 3
        middle = slice(third, 2 * third)
        seen = [
            np.interp(rig.time_s[middle] - late_s, rig.time_s, axis_rate) for axis_rate in rate.T
        ]
        rate[middle] = np.stack(seen, axis=1)
    return gain, solve_motion([(samples_of(rig.time_s, rate), reference_of(rig))])


@pytest.fixture(scope="module")
def alone(rig: Any) -> dict[str, tuple[np.ndarray, ConvergedFit]]:
    return {f"B{n}": board(rig, n) for n in range(BOARDS)}


def test_joint_fit_does_not_increase_uncertainty(
    alone: dict[str, tuple[np.ndarray, ConvergedFit]],
) -> None:
    joint_fit = fit_boards_jointly({name: solution for name, (_, solution) in alone.items()})
    assert not joint_fit.left_out
    assert sorted(joint_fit.solutions) == sorted(alone)
    for name, (gain, solution) in alone.items():
        joint = joint_fit.solutions[name]
        assert joint.converged
        error = (joint.gain - gain).ravel()
        chi2 = error @ np.linalg.solve(joint.observability.covariance[:9, :9], error)
        assert chi2 < 27.9  # of 9 degrees, 99.9 %
        before, after = (np.sqrt(np.diag(s.observability.covariance)) for s in (solution, joint))
        assert np.all(after < before * 1.02)  # the noise is found anew
        session = joint.sessions[0]
        normal = session.normal_equations(joint.gain, joint.noises[0])
        assert motion_agreement_p_value(normal, session.reference) > 1e-4


def test_joint_fit_equals_one_large_fit(
    alone: dict[str, tuple[np.ndarray, ConvergedFit]],
) -> None:
    """Against a dense matrix over all unknowns, with nothing eliminated by blocks."""
    joint = fit_boards_jointly({name: solution for name, (_, solution) in alone.items()})
    solutions = list(joint.solutions.values())
    known = solutions[0].sessions[0].reference.information
    local, shared = known.size
    total = local + BOARDS * BASE_PARAMETERS + shared
    dense = np.zeros((total, total))
    unit = np.concatenate([np.arange(local), np.arange(local + BOARDS * BASE_PARAMETERS, total)])
    dense[np.ix_(unit, unit)] += known.to_dense()
    for n, solution in enumerate(solutions):
        matrix = solution.sessions[0].normal_equations(solution.gain, solution.noises[0]).matrix
        acting = matrix.size[1] - BASE_PARAMETERS
        first = local + BOARDS * BASE_PARAMETERS
        at = np.concatenate(
            [
                np.arange(local),
                local + n * BASE_PARAMETERS + np.arange(BASE_PARAMETERS),
                first + np.arange(acting),
            ]
        )
        dense[np.ix_(at, at)] += matrix.to_dense()
    covariance = np.linalg.inv(dense)
    for n, solution in enumerate(solutions):
        rows = slice(local + n * BASE_PARAMETERS, local + (n + 1) * BASE_PARAMETERS)
        expected = covariance[rows, rows].copy()
        expected[12, 12] += solution.sessions[0].common_std_s ** 2  # a shift that nothing shows
        scale = np.sqrt(np.diag(expected))
        difference = (solution.observability.covariance - expected) / np.outer(scale, scale)
        assert np.abs(difference).max() < 2e-3


def test_board_with_another_motion_is_left_out(
    rig: Any, alone: dict[str, tuple[np.ndarray, ConvergedFit]]
) -> None:
    _, sick = board(rig, 7, late_s=0.01)
    solutions = {name: solution for name, (_, solution) in alone.items()}
    joint = fit_boards_jointly({**solutions, "sick": sick})
    assert list(joint.left_out) == ["sick"]
    assert "differs from that of 4 other boards" in joint.left_out["sick"]
    healthy = fit_boards_jointly(solutions)
    for name, solution in healthy.solutions.items():
        assert joint.solutions[name].estimate == pytest.approx(
            solution.estimate, rel=1e-9, abs=1e-12
        )


def test_two_disagreeing_boards_are_both_left_out(
    rig: Any, alone: dict[str, tuple[np.ndarray, ConvergedFit]]
) -> None:
    _, sick = board(rig, 7, late_s=0.01)
    joint = fit_boards_jointly({"B0": alone["B0"][1], "sick": sick})
    assert not joint.solutions
    assert sorted(joint.left_out) == ["B0", "sick"]
    assert all("differs from that of the other board" in why for why in joint.left_out.values())


def test_single_board_has_no_joint_fit(alone: dict[str, tuple[np.ndarray, ConvergedFit]]) -> None:
    joint = fit_boards_jointly({"B0": alone["B0"][1]})
    assert not joint.solutions
    assert not joint.left_out


def test_stacked_boards_add_scores_of_the_unit(
    alone: dict[str, tuple[np.ndarray, ConvergedFit]],
) -> None:
    (_, first), (_, two) = list(alone.values())[:2]
    normals: list[NormalEquations] = [
        s.sessions[0].normal_equations(s.gain, s.noises[0]) for s in (first, two)
    ]
    both = stack_boards(normals, [BASE_PARAMETERS] * 2)
    local, shared = normals[0].matrix.size
    assert both.matrix.size == (local, shared + BASE_PARAMETERS)
    assert both.score[:local] == pytest.approx(normals[0].score[:local] + normals[1].score[:local])
    assert both.score[local + BASE_PARAMETERS : local + 2 * BASE_PARAMETERS] == pytest.approx(
        normals[1].score[local : local + BASE_PARAMETERS]
    )
