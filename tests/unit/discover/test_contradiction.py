"""Recordings of one board whose gains contradict each other are refused before the search."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver import cli
from gyrorig_solver.pipeline.board_data import load_board
from gyrorig_solver.pipeline.explain_board import explain_boards
from gyrorig_solver.pipeline.recording_agreement import find_disagreement, require_agreement
from gyrorig_solver.uncertainty.gain_agreement import GainEstimate, compare_gains

STD = 1e-3


def _estimate(name: str, scale_x: float = 1.0, temperature_degc: float = 25.0) -> GainEstimate:
    values = np.array([scale_x, 1.0, 1.0, *[0.0] * 6])
    known = np.ones(9, dtype=np.bool_)
    return GainEstimate(name, values, STD**2 * np.eye(9), known, temperature_degc)


def test_the_pair_that_disagrees_most_is_named() -> None:
    estimates = [_estimate("a"), _estimate("b", 1.001), _estimate("c", 1.05)]
    disagreement = compare_gains(estimates)
    assert disagreement is not None
    assert (disagreement.first, disagreement.second, disagreement.parameter) == (
        "a",
        "c",
        "scale.x",
    )
    assert disagreement.sigma == pytest.approx(0.05 / (STD * 2.0**0.5))
    assert disagreement.degrees == 9
    assert compare_gains(estimates[:2]) is None


def test_what_a_recording_does_not_determine_is_not_compared() -> None:
    unknown = replace(_estimate("b", 1.05), is_known=np.arange(9) > 0)
    assert compare_gains([_estimate("a"), unknown]) is None
    nothing = replace(unknown, is_known=np.zeros(9, dtype=np.bool_))
    assert compare_gains([_estimate("a"), nothing]) is None


def test_two_temperatures_may_have_two_scale_factors() -> None:
    """The data sheet allows 160 ppm/K, so 1.6 % over 100 K."""
    cold = _estimate("a", temperature_degc=-40.0)
    assert compare_gains([cold, _estimate("b", 1.02, temperature_degc=-40.0)]) is not None
    assert compare_gains([cold, _estimate("b", 1.02, temperature_degc=60.0)]) is None
    assert compare_gains([cold, _estimate("b", 1.2, temperature_degc=60.0)]) is not None


@pytest.fixture(scope="module")
def pair(hidden: Callable[..., Any]) -> list[Any]:
    """Recordings of two boards that have one name."""
    return [hidden(seed=seed).recording for seed in (11, 1)]


def _words(pair: list[Any]) -> list[str]:
    return [str(recording.path) for recording in pair]


@pytest.mark.long
@pytest.mark.parametrize("command", ["solve", "explain"])
def test_two_boards_of_one_name_are_refused(
    pair: list[Any], command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run([command, *_words(pair), "--out", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert all(recording.path.name in line for recording in pair)
    assert "contradict each other" in line
    assert "misalignment.z differs by 0.0488 rad" in line
    assert "standard uncertainties" in line
    assert not list(tmp_path.rglob("*.yaml"))


@pytest.mark.long
def test_they_are_fitted_together_on_request(
    pair: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["solve", *_words(pair), "--out", str(tmp_path), "--extend", "none", "--json"]
    assert cli.run([*words, "--allow-contradiction"]) == 0
    (board,) = json.loads(capsys.readouterr().out)["boards"]
    assert board["verdict"] != "good"
    warnings = board["calibration"]["quality"]["warnings"]
    assert any("contradict each other" in text for text in warnings)


@pytest.mark.long
def test_recordings_of_one_board_agree(hidden: Callable[..., Any], pair: list[Any]) -> None:
    """Also where one of them has a cause, and the other another program."""
    first, second = pair[1], hidden("bias_step:0.01", seed=1, program="survey-40").recording
    data = load_board([first, second], "GY80-1")
    assert find_disagreement(data) is None
    assert require_agreement(data).comparison == ()


@pytest.mark.long
def test_a_cause_of_one_recording_is_no_contradiction(hidden: Callable[..., Any]) -> None:
    """A scale factor that depends on the rate: the base models alone disagree."""
    recordings = [hidden(seed=1).recording, hidden("scale_quadratic:0.01", seed=1).recording]
    assert find_disagreement(load_board(recordings, "GY80-1")) is None


@pytest.mark.long
def test_each_of_several_boards_is_compared(
    hidden: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> None:
    config = tmp_path_factory.mktemp("rig") / "rig.yaml"
    names = [BoardId("A"), BoardId("B")]
    boards = "".join(f"  - {{id: {name}, port: emulated, format: gcb1}}\n" for name in names)
    config.write_text(
        "schema: gyrorig/rig/1\nrig: two\nptu: {port: emulated, baud: 115200}\n"
        f"boards:\n{boards}emulator: {{seed: 1, dialect: e46, odr_hz: 100, bandwidth_hz: 25.0}}\n",
        encoding="utf-8",
    )
    recordings = [hidden(seed=seed, config=config).recording for seed in (11, 1)]
    outcomes = dict(explain_boards(dict.fromkeys(names, recordings)))
    assert list(outcomes) == names
    for name, outcome in outcomes.items():
        assert isinstance(outcome, UsageError)
        assert f"about board {name}" in str(outcome)
