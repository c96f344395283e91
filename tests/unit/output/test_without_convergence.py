"""A fit that does not converge: no command states its numbers."""

import json
from pathlib import Path

import pytest
from tests.support.emulated_recordings import record_once
from tests.support.made_once import shared_folder

from gyrorig_solver import cli
from gyrorig_solver.estimate import likelihood_fit

Captured = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Record a short program on the emulated rig."""
    return str(record_once(shared_folder(tmp_path_factory), "quick", "--seed", "3").path)


@pytest.fixture
def one_evaluation(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first fit may evaluate its objective once only."""
    monkeypatch.setattr(likelihood_fit, "MAX_EVALUATIONS", 1)


@pytest.mark.usefixtures("one_evaluation")
def test_solve_refuses_in_one_line_and_stores_nothing(
    recorded: str, tmp_path: Path, capsys: Captured
) -> None:
    assert cli.run(["solve", recorded, "--extend", "none", "--out", str(tmp_path)]) == 3
    captured = capsys.readouterr()
    lines = [line for line in captured.err.splitlines() if line]
    assert len(lines) == 1, captured.err
    assert "the fit did not converge" in lines[0]
    assert "still moves by" in lines[0]
    assert "`gyrorig explain`" in lines[0]
    assert captured.out == ""
    assert not list(tmp_path.glob("**/v*.yaml"))


@pytest.mark.usefixtures("one_evaluation")
def test_explain_says_that_the_base_fit_did_not_converge(
    recorded: str, tmp_path: Path, capsys: Captured
) -> None:
    assert cli.run(["explain", recorded, "--out", str(tmp_path), "--json"]) in (0, 4)
    document = json.loads(capsys.readouterr().out)
    assert "did not converge" in json.dumps(document)
