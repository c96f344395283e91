# ruff: noqa: T201
"""The wheel with each extra, in an environment of its own, run: `make test-packages`.

Every Python of 3.11 and newer that is found is used (`python3.11` and so on, on the path or
under $PYENV_ROOT). Needs a package index; minutes. One line for each, and a table at the end.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "release"))

from locked_install import CannotInstallError, install_locked  # noqa: E402

MINORS = (11, 12, 13, 14)
EXTRAS = ("", "solver", "fleet", "live", "docs")
SHORT = """schema: gyrorig/program/1
name: short
description: 2 s at rest
steps:
  - rest: {seconds: 2.0, phase: static}
"""
VIEW = """
from gyrorig_daemon.live.foxglove_view import open_live_view
view = open_live_view("127.0.0.1:0", print)
view.show_status({"state": "ready"})
view.close()
"""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one Python with one extra."""

    python: str
    extra: str
    problem: str  # empty: all well
    seconds: float
    packages: int


def pythons(minors: Sequence[int]) -> Iterator[Path]:
    """Yield each interpreter of a version that the project supports."""
    versions = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    for minor in minors:
        interpreters = sorted(versions.glob(f"3.{minor}.*/bin/python"))
        on_path = shutil.which(f"python3.{minor}")
        if interpreters:
            yield interpreters[-1]
        elif (
            on_path
            and subprocess.run([on_path, "-c", "import ensurepip"], check=False).returncode == 0
        ):
            yield Path(on_path)


def outcome(python: Path, extra: str, folder: Path) -> Outcome:
    """Install and run; never raises for what the wheel does wrong."""
    begun = time.monotonic()
    name = subprocess.run([python, "--version"], capture_output=True, text=True, check=True).stdout
    problem, count = "", 0
    try:
        subprocess.run([python, "-m", "venv", folder], check=True, capture_output=True)
        install_locked(folder / "bin" / "python", [extra] if extra else [])
        listed = subprocess.run(
            [folder / "bin" / "python", "-m", "pip", "list", "--format", "json"],
            check=True, capture_output=True, text=True,
        )  # fmt: skip
        count = len(json.loads(listed.stdout))
        _use(folder, extra)
    except CannotInstallError as fault:
        problem = str(fault)
    except subprocess.CalledProcessError as fault:
        problem = f"{' '.join(map(str, fault.cmd))[-80:]}: {str(fault.stderr).strip()[-300:]}"
    return Outcome(name.strip(), extra or "(none)", problem, time.monotonic() - begun, count)


def _use(folder: Path, extra: str) -> None:
    """Run what this extra is for, away from the checkout."""
    (folder / "short.yaml").write_text(SHORT)
    config = folder / "share" / "gyrorig" / "config"

    def run(*line: str, code: int = 0) -> None:
        program, *rest = line
        process = subprocess.run(
            [folder / "bin" / program, *rest],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        if process.returncode != code:
            raise subprocess.CalledProcessError(
                process.returncode, line, process.stdout, process.stderr
            )

    run("gyrorig", "--version")
    run(
        "gyrorigd", "record", "--simulated-time", "--session", "short", "--config",
        str(config / "rig.yaml"), "--program", "short.yaml", "--out", "recordings",
    )  # fmt: skip
    (recording,) = map(str, (folder / "recordings").glob("*.mcap"))
    if extra in ("solver", "fleet"):
        run("gyrorig", "check", recording, code=4)  # says that rest shows no more
        run("gyrorig", "solve", recording, code=4)  # at rest: only the bias and the noise
    else:
        run("gyrorig", "solve", recording, code=2)  # says which extra is missing
    if extra == "live":
        run("python", "-c", VIEW)
    if extra == "docs":
        run("mkdocs", "--version")  # the site itself is made in a checkout
    if extra == "fleet":
        run("gyrorig", "batch", "--spool", "recordings", "--store", "store")
        run("gyrorig", "store", "verify", "store")


def main() -> int:
    """Try every Python with every extra, or those asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minor", type=int, action="append", help="3.MINOR alone")
    parser.add_argument("--extra", action="append", help="this extra alone; '' is none")
    arguments = parser.parse_args()
    missed = 0
    with tempfile.TemporaryDirectory() as name:
        for python in pythons(arguments.minor or MINORS):
            for extra in arguments.extra or EXTRAS:
                place = Path(name) / "venv"
                result = outcome(python, extra, place)
                shutil.rmtree(place, ignore_errors=True)
                missed += bool(result.problem)
                print(
                    f"{result.python:14} {result.extra:13} {result.packages:3} packages "
                    f"{result.seconds:5.1f} s  {result.problem or 'works'}",
                    flush=True,
                )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
