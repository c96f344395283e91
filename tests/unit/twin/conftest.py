"""Recordings of emulated rigs with their truth, and their twins by the command."""

import json
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.support.commands_in_process import run_command

from gyrorig_daemon.cli import run as run_daemon
from gyrorig_protocol.twin import Twin, parse_twin
from gyrorig_solver.cli import run as run_solver

ROOT = Path(__file__).resolve().parents[3]
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
    """Run a command of `gyrorig` in this process."""
    return run_command(run_solver, *map(str, words))


def record(
    out: Path, *options: str, program: str = "survey-40", config: Path | None = None
) -> tuple[Path, dict[str, Any]]:
    """Record an emulated rig; return the recording and the truth."""
    words = ["record", "--simulated-time", "--out", out]
    words += ["--config", config or ROOT / "config" / "rig.yaml"]
    words += ["--program", ROOT / "config" / "programs" / f"{program}.yaml"]
    words += ["--truth", out / "truth.yaml", *options]
    out.mkdir(parents=True, exist_ok=True)
    run_command(run_daemon, *map(str, words)).check_returncode()
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
