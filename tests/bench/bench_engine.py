"""What a criticised solve costs: processor time after start-up, and peak memory, of two trees.

Emulated rigs carry out motion programs in simulated time. Their recordings are made once, by this
tree, and kept in a folder. Each command then runs in a process that has solved a short recording
before: imports and caches of the process do not count. A command is what a user types, so an older
tree with other packages is measured in the same way.

Run: python tests/bench/bench_engine.py [--tree DIR] [--only CASE] [--turns N] [--recordings FOLDER]
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.hidden.truth.outside import SHAPES
from tests.hidden.truth.programs import read_program_text
from tests.hidden.truth.session import RigDraw, make_settings, record
from tests.hidden.truth.shapes import make_shape_adder

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("daemon", "solver", "firmware_protocol")
SEED = 3
MARK = "MEASURED "
Figures = dict[str, float]
EIGHT = (
    *("backlash", "eccentricity", "clock_skew", "scale_quadratic"),
    *("motor_coupling", "ringing", "worm_error", "supply_hum"),
)

# Runs in the measured tree: click commands in one process, the first one as a warm-up.
PROBE = """
import json, sys, tempfile, time
from gyrorig_solver.cli import main

def run(words):
    with tempfile.TemporaryDirectory() as out:
        sys.argv = ["gyrorig", *words, "--out", out]
        begin = time.process_time()
        try:
            main()
        except SystemExit as ended:
            if ended.code not in (0, 4, None):
                raise
        return time.process_time() - begin

def peak_mb():
    for line in open("/proc/self/status"):
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1024.0

commands = json.loads(sys.argv[1])
run(commands[0])
seconds = [run(words) for words in commands[1:]]
print("MEASURED " + json.dumps(dict(seconds=min(seconds), peak_mb=peak_mb())))
"""


@dataclass(frozen=True, slots=True)
class Case:
    """A recording, and what is run on it.

    Attributes:
        program: of the session; see `tests.hidden.truth.programs`.
        wanted_s: of all commands together.
        hide: causes, as typed.
        shape: effect outside the catalogue, and its size.
        rate_hz: of the board.
        command: what is measured, `solve` with full criticism.
        wanted_mb: peak memory.
    """

    program: str
    wanted_s: float
    hide: tuple[str, ...] = ()
    shape: tuple[str, float] | None = None
    rate_hz: int = 100
    command: str = "explain"
    wanted_mb: float = 400.0


SURVEY_300 = "survey-130+survey-130+survey-40"
FAST_HZ, FAST_BANDWIDTH_HZ = 800, 110.0
BOTH = ("solve", "explain")
CASES = {
    "nothing hidden": Case(SURVEY_300, 1.2, command="solve"),
    "one cause": Case(SURVEY_300, 3.0, ("eccentricity@pan",)),
    "eight causes": Case("full", 12.0, EIGHT),
    "outside": Case(SURVEY_300, 10.0, shape=("rate_delay", 3e-4)),
    "800 Hz": Case("paper", 1.0 / 15.0, rate_hz=FAST_HZ, command="solve"),
}
WARM_UP, CASES_WARM_UP = "warm-up", Case("quick", 0.0)


def make_recording(case: Case, path: Path) -> None:
    """Record a session of an emulated rig at `path`."""
    if case.shape is not None:
        draw = RigDraw(SEED, case.program)
        record(
            draw,
            path,
            None,
            make_shape_adder(SHAPES[case.shape[0]], case.shape[1], make_settings(draw)),
        )
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rig = (ROOT / "config" / "rig.yaml").read_text(encoding="utf-8")
        rig = rig.replace("odr_hz: 100", f"odr_hz: {case.rate_hz}")
        if case.rate_hz == FAST_HZ:
            rig = rig.replace("bandwidth_hz: 25.0", f"bandwidth_hz: {FAST_BANDWIDTH_HZ}")
        (folder / "rig.yaml").write_text(rig, encoding="utf-8")
        (folder / "program.yaml").write_bytes(read_program_text(case.program))
        command = [str(Path(sys.executable).with_name("gyrorigd")), "record", "--simulated-time"]
        command += ["--config", str(folder / "rig.yaml"), "--seed", str(SEED)]
        command += ["--program", str(folder / "program.yaml"), "--out", str(folder / "out")]
        command += [word for cause in case.hide for word in ("--hide", cause)]
        subprocess.run(command, check=True, capture_output=True)
        shutil.move(next((folder / "out").glob("*.mcap")), path)


def measure(tree: Path, words: Sequence[str], warm_up: Path, turns: int) -> dict[str, float]:
    """Return processor time after start-up in s and peak memory in MB of one command.

    Args:
        tree: source tree whose packages run.
        words: command line after `gyrorig`.
        warm_up: recording that the same command reads first.
        turns: how often the command runs; the least time counts.
    """
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("GYRORIG_", "PYTHON"))}
    path = os.pathsep.join(str(tree / package) for package in PACKAGES)
    fixed = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
    commands = [[words[0], str(warm_up)], *[list(words)] * turns]
    process = subprocess.run(
        [sys.executable, "-c", PROBE, json.dumps(commands)],
        env={**environment, **fixed, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    measured = [line for line in process.stdout.splitlines() if line.startswith(MARK)]
    if process.returncode or not measured:
        raise RuntimeError(process.stderr)
    figures: dict[str, float] = json.loads(measured[0].removeprefix(MARK))
    return figures


def commands_of(case: Case, tree: Path) -> tuple[str, ...]:
    """Return the commands that solve and criticise; an older tree needs two."""
    criticises = tree / "solver" / "gyrorig_solver" / "pipeline" / "criticised_fit.py"
    return BOTH if case.command == "solve" and not criticises.exists() else (case.command,)


def measured_case(case: Case, tree: Path, recording: Path, warm_up: Path, turns: int) -> Figures:
    """Return seconds of each command and in total, and the peak memory of the largest."""
    each = {
        command: measure(tree, (command, str(recording)), warm_up, turns)
        for command in commands_of(case, tree)
    }
    return {
        **{f"{command}_s": run["seconds"] for command, run in each.items()},
        "total_s": sum(run["seconds"] for run in each.values()),
        "peak_mb": max(run["peak_mb"] for run in each.values()),
    }


def line_of(name: str, case: Case, figures: Figures, old: Figures | None) -> str:
    """Return one line of the table."""
    text = f"{name:<16}{figures['total_s']:8.2f} s (wanted {case.wanted_s:6.2f}) "
    text += f"{figures['peak_mb']:7.0f} MB (wanted {case.wanted_mb:4.0f})"
    if old is not None:
        text += f"  other tree {old['total_s']:8.2f} s {old['peak_mb']:7.0f} MB"
        text += f"  ratio {old['total_s'] / figures['total_s']:6.2f}"
    return text


def main() -> int:
    """Measure and print; 1 where a wanted time or memory is not reached."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--tree", type=Path, help="another source tree to compare with")
    parser.add_argument("--only", choices=list(CASES), help="one case")
    parser.add_argument("--turns", type=int, default=1)
    parser.add_argument("--recordings", type=Path, help="folder that keeps the recordings")
    parser.add_argument("--out", type=Path, help="write the figures there")
    asked = parser.parse_args()
    figures: dict[str, dict[str, Figures]] = {}
    missed = False
    with tempfile.TemporaryDirectory() as scratch:
        folder = (asked.recordings or Path(scratch)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        for name, case in {WARM_UP: CASES_WARM_UP, **CASES}.items():
            if asked.only in (None, name) or name == WARM_UP:
                path = folder / f"{name.replace(' ', '-')}.mcap"
                if not path.exists():
                    make_recording(case, path)
                if name == WARM_UP:
                    warm_up = path
                    continue
                trees = {"this": ROOT} | ({"other": asked.tree.resolve()} if asked.tree else {})
                figures[name] = {
                    which: measured_case(case, tree, path, warm_up, asked.turns)
                    for which, tree in trees.items()
                }
                measured = figures[name]["this"]
                missed |= (
                    measured["total_s"] > case.wanted_s or measured["peak_mb"] > case.wanted_mb
                )
                print(line_of(name, case, measured, figures[name].get("other")), flush=True)  # noqa: T201
    if asked.out:
        asked.out.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
