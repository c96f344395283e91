"""Recordings of emulated rigs in simulated time, each made once in a run of the tests.

What to use when: `record_once` where a test reads a recording. A test of recording itself calls
the command, and so does a test that changes the files: these are shared by all tests of a run.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.support.commands_in_process import run_command
from tests.support.made_once import made_once

from gyrorig_daemon.cli import run
from gyrorig_protocol.documents import parse_yaml

CONFIG = Path(__file__).resolve().parents[2] / "config"


@dataclass(frozen=True, slots=True)
class EmulatedRecording:
    """A recording of an emulated rig, and its true parameters."""

    path: Path
    truth_path: Path

    @property
    def truth(self) -> Any:
        """The document of the true parameters."""
        return parse_yaml(self.truth_path.read_bytes(), self.truth_path.name)


RecordOnce = Callable[..., EmulatedRecording]


def record_once(
    shared: Path, program: str | Path, *options: str, config: Path = CONFIG / "rig.yaml"
) -> EmulatedRecording:
    """Record an emulated rig, or return the recording that an earlier call made.

    Args:
        shared: from `shared_folder`.
        program: the name of a program in config/programs, or the path of another one.
        options: further options of `gyrorigd record`, without files: `--seed`, `--hide`.
        config: the rig file.

    Raises:
        RuntimeError: the command failed.
    """
    path = CONFIG / "programs" / f"{program}.yaml" if isinstance(program, str) else program

    def make(out: Path) -> None:
        words = ["record", "--simulated-time", "--config", str(config), "--program", str(path)]
        words += ["--out", str(out), "--truth", str(out / "truth.yaml"), *options]
        process = run_command(run, *words)
        if process.returncode:
            raise RuntimeError(process.stderr)

    key: list[str | bytes] = ["recording", config.read_bytes(), path.read_bytes(), *options]
    folder = made_once(shared, key, make)
    return EmulatedRecording(next(folder.glob("*.mcap")), folder / "truth.yaml")
