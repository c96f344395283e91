"""Recordings of one board, at rest and in motion, through the commands: one version."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent


def _record(out: Path, program: str) -> Path:
    command = [BIN / "gyrorigd", "record", "--simulated-time", "--seed", "5", "--out", out]
    command += ["--config", ROOT / "config" / "rig.yaml"]
    command += ["--program", ROOT / "config" / "programs" / program]
    subprocess.run([*map(str, command)], check=True, capture_output=True)
    return next(out.glob("*.mcap"))


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of the program `quick`, which no test changes."""
    return _record(tmp_path_factory.mktemp("quick"), "quick.yaml")


def test_static_and_moving_make_one_version(tmp_path: Path, quick: Path, contracts: Path) -> None:
    recordings = [quick, _record(tmp_path / "s", "static.yaml")]
    command = [str(BIN / "gyrorig"), "solve", *map(str, recordings), "--out", str(tmp_path / "c")]
    process = subprocess.run([*command, "--json"], check=False, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    (board,) = json.loads(process.stdout)["boards"]
    path = Path(board["file"])
    assert path.name == "v0001.yaml"
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    # In the order of time, whatever the order of the arguments.
    assert [i["name"] for i in document["inputs"]] == [r.name for r in recordings]
    moving, still = document["quality"]["recordings"]
    assert document["observability"]["unobservable"] == []
    # The last one lay still: its bias is the newest, the offset is that of the one before.
    assert still["time_offset"] is None
    assert document["parameters"]["time_offset"]["value"] == moving["time_offset"]
    assert document["parameters"]["bias"]["value"] == still["bias"]
    assert document["parameters"]["scale"]["value"][0] is not None
    judge = contracts.parent / "tools" / "check_contract.py"
    checked = subprocess.run(
        [sys.executable, str(judge), str(path)], check=False, capture_output=True, text=True
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_one_recording_twice_is_refused(tmp_path: Path, quick: Path) -> None:
    twin = tmp_path / "copy.mcap"
    twin.write_bytes(quick.read_bytes())
    command = [str(BIN / "gyrorig"), "solve", str(quick), str(twin), "--out", str(tmp_path)]
    process = subprocess.run(command, check=False, capture_output=True, text=True)
    assert process.returncode == 2
    assert "contain the same recording" in process.stderr
    assert not list(tmp_path.rglob("v0001.yaml"))


def test_boards_on_one_unit_are_solved_together(tmp_path: Path) -> None:
    """One on a serial port, two on CAN; the sixteen of `rig-sixteen` are in the benchmark."""
    rig = yaml.safe_load((ROOT / "config" / "rig-sixteen.yaml").read_text(encoding="utf-8"))
    rig["boards"] = [board for board in rig["boards"] if board["id"] in ("S1", "C1", "C2")]
    rig["buses"] = rig["buses"][:1]
    config = tmp_path / "rig.yaml"
    config.write_text(yaml.safe_dump(rig), encoding="utf-8")
    command = [BIN / "gyrorigd", "record", "--simulated-time", "--seed", "5", "--config", config]
    command += [
        "--program",
        ROOT / "config" / "programs" / "survey-40.yaml",
        "--out",
        tmp_path / "r",
    ]
    subprocess.run([*map(str, command)], check=True, capture_output=True)
    (recording,) = (tmp_path / "r").glob("*.mcap")
    solve = [str(BIN / "gyrorig"), "solve", str(recording), "--json", "--out", str(tmp_path / "c")]
    process = subprocess.run(solve, check=False, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    boards = json.loads(process.stdout)["boards"]
    assert sorted(board["board"] for board in boards) == ["C1", "C2", "S1"]
    for result in boards:
        assert result["verdict"] == "good"
        quality = result["calibration"]["quality"]
        assert quality["boards_together"] == 3
        # Those of a bus have one time, by the edges that both saw.
        on_bus = result["board"] != "S1"
        assert quality.get("boards_on_one_clock") == (2 if on_bus else None)
        assert not on_bus or 0.0 < quality["clock_moved_s"] < 1e-4
    alone = subprocess.run([*solve, "--board", "C1"], check=False, capture_output=True, text=True)
    (board,) = json.loads(alone.stdout)["boards"]
    assert board["version"] == 2
    assert "boards_together" not in board["calibration"]["quality"]
    (before,) = (board for board in boards if board["board"] == "C1")
    separate, joint = (x["calibration"]["parameters"]["scale"] for x in (board, before))
    for value, other, std in zip(separate["value"], joint["value"], separate["std"], strict=True):
        assert abs(value - other) < 2.0 * std
