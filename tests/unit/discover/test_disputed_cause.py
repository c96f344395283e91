"""A cause of the unit about whose size its boards disagree has no common value."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrorig_solver.discover import explain_jointly
from gyrorig_solver.estimate import MIN_HOMOGENEITY_P, ConvergedFit, homogeneity_p_values
from gyrorig_solver.pipeline.assessed_fit import AssessedFit, add_to_unit
from gyrorig_solver.pipeline.board_data import load_board
from gyrorig_solver.pipeline.board_results import CriticisedFit
from gyrorig_solver.pipeline.criticised_fit import JointFit, solve_jointly
from gyrorig_solver.pipeline.joint_data import JointData
from gyrorig_solver.pipeline.prepare_board import fit_base
from gyrorig_solver.pipeline.unit_prior import UnitKnowledge
from gyrorig_solver.uncertainty import assess_uncertainty, default_settings

pytestmark = pytest.mark.long

BOARDS = ("GY80-1", "GY80-2")
SIZE_RAD, CLOSE_RAD, OTHER_RAD = 1.5e-3, 1.5e-3, 1.3e-3  # other: 5 standard uncertainties
FAR = 4.0  # standard uncertainties


class _ReadOnly(UnitKnowledge):
    """Fails where something is added to the posterior of a unit."""

    def add(self, *_: Any) -> None:
        raise AssertionError("the board is disputed")


Rig = Callable[..., dict[str, JointFit]]


@pytest.fixture(scope="module")
def solved(hidden: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Rig:
    """Return a function that solves two boards, each with the play of its mount."""
    config = tmp_path_factory.mktemp("rig") / "rig.yaml"
    boards = "".join(f"  - {{id: {name}, port: emulated, format: gcb1}}\n" for name in BOARDS)
    config.write_text(
        "schema: gyrorig/rig/1\nrig: two\nptu: {port: emulated, baud: 115200}\n"
        f"boards:\n{boards}emulator: {{seed: 1, dialect: e46, odr_hz: 100, bandwidth_hz: 25.0}}\n",
        encoding="utf-8",
    )

    def solve(*sizes_rad: float) -> dict[str, JointFit]:
        data = {}
        for name, size_rad in zip(BOARDS, sizes_rad, strict=True):
            session = hidden(f"backlash@tilt:{size_rad}", seed=3, config=Path(config))
            data[name] = load_board([session.recording], name)
        explained = explain_jointly({name: fit_base(board) for name, board in data.items()})
        joint = solve_jointly(
            JointData(data[BOARDS[0]].recordings, data, {}, {}),
            named_terms={name: each.findings.fitted_terms for name, each in explained.items()},
            solutions={name: each.solution_extended for name, each in explained.items()},
        )
        fits = {name: fit for name, fit in joint.items() if isinstance(fit, JointFit)}
        assert list(fits) == list(BOARDS)
        return fits

    return solve


def _play(solution: ConvergedFit) -> tuple[float, float]:
    """Return the play of a fit and its standard uncertainty, rad."""
    index = solution.names.index("backlash.gap.tilt")
    std = float(np.sqrt(solution.observability.covariance[index, index]))
    return float(solution.estimate[index]), std


def test_boards_that_disagree_keep_their_sizes(solved: Rig) -> None:
    fits = solved(SIZE_RAD, OTHER_RAD)
    for fit, true_rad in zip(fits.values(), (SIZE_RAD, OTHER_RAD), strict=True):
        value, std = _play(fit.solution)
        assert abs(value - true_rad) < FAR * std
        assert fit.disputed == ("backlash",)
        (warning,) = (text for text in fit.fit.warnings if "disagree" in text)
        assert "backlash" in warning
        assert "mount" in warning
        assert fit.fit.sharing.fitted_together == 2
    p_values = homogeneity_p_values([fit.solution for fit in fits.values()], {"backlash"})
    assert p_values["backlash"] < MIN_HOMOGENEITY_P
    assert homogeneity_p_values([fit.solution for fit in fits.values()], set()) == {}


def test_boards_that_agree_have_one_size(solved: Rig) -> None:
    fits = solved(SIZE_RAD, CLOSE_RAD)
    (first, first_std), (second, second_std) = (_play(fit.solution) for fit in fits.values())
    assert first == pytest.approx(second, rel=1e-12)
    assert first_std == pytest.approx(second_std, rel=1e-6)
    assert abs(first - SIZE_RAD) < FAR * first_std
    assert all(fit.disputed == () for fit in fits.values())


def test_a_disputed_cause_adds_nothing_to_the_unit(solved: Rig) -> None:
    fit = solved(SIZE_RAD, OTHER_RAD)[BOARDS[0]]
    settings = default_settings()
    assessed = AssessedFit(fit.fit, assess_uncertainty(fit.solution, settings))
    criticised = CriticisedFit(fit.fit, fit.solution, disputed_causes=fit.disputed)
    data = load_board([], BOARDS[0])
    assert add_to_unit(data, criticised, assessed, settings, _ReadOnly()) is None
