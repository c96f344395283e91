"""`gyrorig twin-check` on a rig with a hidden cause: before, after, and a twin that lacks it."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from gyrorig_daemon.cli import run as run_daemon
from gyrorig_protocol.documents import dump_yaml, parse_yaml
from gyrorig_solver.cli import run
from gyrorig_solver.commands.project_files import project_file

pytestmark = pytest.mark.long

HIDDEN = "backlash@pan"


def record(folder: Path, program: str, session_seed: int) -> Path:
    """Record the rig with the hidden cause; return the recording."""
    arguments = [
        *("record", "--simulated-time", "--config", str(project_file("rig.yaml"))),
        *("--program", str(project_file("programs", program)), "--seed", "5", "--hide", HIDDEN),
        *("--session-seed", str(session_seed), "--session", f"s{session_seed}"),
        *("--out", str(folder)),
    ]
    assert run_daemon(arguments) == 0
    return next(folder.glob(f"*_s{session_seed}.mcap"))


@pytest.fixture(scope="module")
def session_files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the folder of the twin, and a recording that it was not fitted to."""
    folder = tmp_path_factory.mktemp("twin-check")
    fitted = record(folder, "survey-40.yaml", 11)
    assert run(["-q", "twin", str(fitted), "--out", str(folder / "twin")]) == 0
    return folder / "twin", record(folder, "quick.yaml", 12)


def check(folder: Path, recording: Path, draws: int = 10) -> Any:
    """Run the command; return its result for the only board."""
    assert run(["-q", "twin-check", str(recording), str(folder), "--draws", str(draws)]) == 0
    page = (folder / "twin-check.html").read_text()
    assert "Simulation before / after / measured" in page
    result = json.loads((folder / "twin-check.json").read_text())
    assert result["schema"] == "gyrorig/twin-check/1"
    return result["boards"][0]


@pytest.fixture(scope="module")
def checked(session_files: tuple[Path, Path]) -> Any:
    """Return the result for the recording that the twin was not fitted to."""
    return check(*session_files)


def test_the_twin_predicts_a_new_recording(checked: Any) -> None:
    """Another program, other noise: the default simulation is wrong, the twin is not."""
    board = checked
    assert board["held_out"]
    assert board["before"]["differences"]
    assert not board["after"]["differences"]
    assert board["recovered_share"] > 0.95


def test_calibration_and_causes_share_the_gain(
    checked: Any, session_files: tuple[Path, Path]
) -> None:
    """The twin without its causes is between both; the causes recover what it gets wrong."""
    board = checked
    densities = [board[stage]["log_density_nats_per_s"] for stage in ("before", "without_causes")]
    assert densities[0] < densities[1] < board["after"]["log_density_nats_per_s"]
    parts = board["calibration_gain_nats_per_s"], board["cause_gain_nats_per_s"]
    assert min(parts) > 0.0
    assert sum(parts) == pytest.approx(board["gain_nats_per_s"])
    assert abs(1.0 - board["cause_share"]) < 3.0 * board["cause_share_std"]
    page = (session_files[0] / "twin-check.html").read_text()
    assert "is due to the calibration and" in page
    assert re.search(r"gap\.pan \S+ ± \S+ deg, ", page), "fitted values beside the equation"


def test_a_missing_cause_is_listed(session_files: tuple[Path, Path], tmp_path: Path) -> None:
    """A twin without the hidden cause differs in what depends on pan; few draws show less."""
    folder, recording = session_files
    document = parse_yaml((folder / "twin.yaml").read_bytes(), "twin.yaml")
    document["twin"]["causes"] = []
    names = document["twin"].get("posterior", {}).get("names", [])
    assert any(name.startswith("causes.") for name in names)
    del document["twin"]["posterior"]
    document["twin"]["boards"]["GY80-1"]["unexplained"] = ["on pan (the bias changes)"]
    (tmp_path / "twin.yaml").write_text(dump_yaml(document))
    board = check(tmp_path, recording, draws=20)
    assert board["without_causes"] is None
    assert board["cause_gain_nats_per_s"] == 0.0
    assert board["different"]
    assert any("pan" in text for text in board["after"]["differences"])
    assert board["unexplained"] == ["on pan (the bias changes)"]
    page = (tmp_path / "twin-check.html").read_text()
    assert "depends on pan (the bias changes). No known cause explains it" in page


def test_a_folder_without_twin_is_refused(tmp_path: Path, session_files: tuple[Path, Path]) -> None:
    """One line, exit status 2."""
    assert run(["twin-check", str(session_files[1]), str(tmp_path)]) == 2


def test_the_file_of_a_twin_is_refused(
    session_files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """The command wants the folder; one line, exit status 2."""
    folder, recording = session_files
    assert run(["twin-check", str(recording), str(folder / "twin.yaml")]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "is a file" in line
    assert line.endswith(f"Give the folder {folder}.")
