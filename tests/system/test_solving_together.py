"""Recordings of one board, at rest and in motion, through the commands: one version."""

import json
import subprocess
import sys
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent


def _record(out: Path, program: str) -> Path:
    command = [BIN / "gyrorigd", "record", "--simulated-time", "--seed", "5", "--out", out]
    command += ["--config", ROOT / "config" / "rig.yaml"]
    command += ["--program", ROOT / "config" / "programs" / program]
    subprocess.run([*map(str, command)], check=True, capture_output=True)
    return next(out.glob("*.mcap"))


def test_static_and_moving_make_one_version(tmp_path: Path, contracts: Path) -> None:
    recordings = [_record(tmp_path / "m", "quick.yaml"), _record(tmp_path / "s", "static.yaml")]
    command = [str(BIN / "gyrorig"), "solve", *map(str, recordings), "--out", str(tmp_path / "c")]
    done = subprocess.run([*command, "--json"], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (board,) = json.loads(done.stdout)["boards"]
    path = Path(board["file"])
    assert path.name == "v0001.yaml"
    found = yaml.safe_load(path.read_text(encoding="utf-8"))
    # In the order of time, whatever the order of the arguments.
    assert [i["name"] for i in found["inputs"]] == [r.name for r in recordings]
    moving, still = found["quality"]["recordings"]
    assert found["observability"]["unobservable"] == []
    # The last one lay still: its bias is the newest, the offset is that of the one before.
    assert still["time_offset"] is None
    assert found["parameters"]["time_offset"]["value"] == moving["time_offset"]
    assert found["parameters"]["bias"]["value"] == still["bias"]
    assert found["parameters"]["scale"]["value"][0] is not None
    judge = contracts.parent / "tools" / "check_contract.py"
    checked = subprocess.run(
        [sys.executable, str(judge), str(path)], check=False, capture_output=True, text=True
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_one_recording_twice_is_refused(tmp_path: Path) -> None:
    recording = _record(tmp_path / "m", "quick.yaml")
    twin = tmp_path / "copy.mcap"
    twin.write_bytes(recording.read_bytes())
    command = [str(BIN / "gyrorig"), "solve", str(recording), str(twin), "--out", str(tmp_path)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 2
    assert "are one recording" in done.stderr
    assert not list(tmp_path.rglob("v0001.yaml"))
