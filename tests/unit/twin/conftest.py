"""Recordings of emulated rigs with their truth, and their twins by the command."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from gyrorig_protocol.twin import Twin, parse_twin

ROOT = Path(__file__).resolve().parents[3]
BIN = Path(sys.executable).parent
COMMAND_TIME_S = 5e-3  # of config/rig.yaml


@dataclass(frozen=True, slots=True)
class RecordedTwin:
    """A recording of an emulated rig, its truth, and the twin that was made of it."""

    recording: Path
    truth: dict[str, Any]
    file: Path  # of the twin
    printed: dict[str, Any]  # by --json

    @property
    def twin(self) -> Twin:
        """The section of the file."""
        return parse_twin(self.file.read_bytes(), self.file.name)


def run_gyrorig(*words: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a command of `gyrorig`."""
    command = [str(BIN / "gyrorig"), *map(str, words)]
    return subprocess.run(command, check=False, capture_output=True, text=True)


def record(
    out: Path, *options: str, program: str = "survey-40", config: Path | None = None
) -> tuple[Path, dict[str, Any]]:
    """Record an emulated rig; return the recording and the truth."""
    command = [BIN / "gyrorigd", "record", "--simulated-time", "--out", out]
    command += ["--config", config or ROOT / "config" / "rig.yaml"]
    command += ["--program", ROOT / "config" / "programs" / f"{program}.yaml"]
    command += ["--truth", out / "truth.yaml", *options]
    out.mkdir(parents=True, exist_ok=True)
    subprocess.run([*map(str, command)], check=True, capture_output=True)
    return next(out.glob("*.mcap")), yaml.safe_load((out / "truth.yaml").read_text("utf-8"))


@pytest.fixture(scope="session")
def recorded_twin(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., RecordedTwin]:
    """Return what records an emulated rig and makes its twin."""

    def make(*options: str, program: str = "survey-40", rig: str = "") -> RecordedTwin:
        folder = tmp_path_factory.mktemp("twin")
        config = None
        if rig:
            config = folder / "rig.yaml"
            config.write_text(rig, encoding="utf-8")
        recording, truth = record(folder, *options, program=program, config=config)
        process = run_gyrorig("twin", recording, "--out", folder / "twin", "--json")
        assert process.returncode == 0, process.stderr
        printed = json.loads(process.stdout)
        return RecordedTwin(recording, truth, Path(printed["file"]), printed)

    return make
