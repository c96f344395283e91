"""What `gyrorig explain` costs: a plain run of each shipped program, and one with 8 causes.

The emulated rig carries out each program in simulated time; the whole command is then run
in a process of its own, some times, and its least wall time counts: imports, reading, the
search, the page. What each step takes is measured in this process, warm, as a batch has it.

Run: python tests/bench/bench_explain.py [--turns N] [--only PROGRAM] [--out FILE]
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.data.clocks.lower_envelope import _cached_envelope
from gyrorig_solver.discover import candidate_fits, cause_search, fit_explanation, motion_space
from gyrorig_solver.pipeline import explain_board

ROOT = Path(__file__).resolve().parents[2]
EIGHT = (
    *("backlash", "eccentricity", "clock_skew", "scale_quadratic"),
    *("motor_coupling", "ringing", "worm_error", "supply_hum"),
)
PLAIN_S, EIGHT_S = 2.0, 60.0  # bars, wall time of the whole command
SEED = 3


def record(folder: Path, program: str, hide: tuple[str, ...] = ()) -> Path:
    """Record a program on the emulated rig, with causes hidden in it."""
    command = [str(Path(sys.executable).with_name("gyrorigd")), "record", "--simulated-time"]
    command += ["--config", str(ROOT / "config" / "rig.yaml"), "--seed", str(SEED)]
    command += ["--program", str(ROOT / "config" / "programs" / f"{program}.yaml")]
    command += [word for cause in hide for word in ("--hide", cause)]
    subprocess.run([*command, "--out", str(folder)], check=True, capture_output=True)
    return next(folder.glob("*.mcap"))


def whole(path: Path, turns: int) -> dict[str, float]:
    """Run the command so many times; return its least wall and processor time."""
    command = [sys.executable, "-m", "gyrorig_solver", "explain", str(path)]
    # As installed: compiled once.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    wall, spent = [], []
    with tempfile.TemporaryDirectory() as out:
        for _ in range(turns):
            before, begin = os.times(), time.monotonic()
            process = subprocess.run(
                [*command, "--out", out], capture_output=True, check=False, env=environment
            )
            wall.append(time.monotonic() - begin)
            after = os.times()
            spent.append(
                after.children_user
                + after.children_system
                - before.children_user
                - before.children_system
            )
            if process.returncode not in (0, 4):
                raise RuntimeError(process.stderr.decode())
    return {"wall_s": min(wall), "processor_s": min(spent)}


def steps(path: Path) -> tuple[dict[str, float], list[str]]:
    """Return the processor time of each step in this process, and the causes named."""
    spent: dict[str, float] = {}

    def booked(step: str, of: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **more: Any) -> Any:
            begin = time.process_time()
            try:
                return of(*args, **more)
            finally:
                spent[step] = spent.get(step, 0.0) + time.process_time() - begin

        return call

    watched = [
        (explain_board, "fit_base", "base fit"),
        (cause_search, "scan_catalogue", "score passes"),
        (candidate_fits, "fit_candidate", "exact fits"),
        (motion_space, "refit_with_terms", "fits of all"),
        (fit_explanation, "cross_validate_causes", "held-out gain"),
        (explain_board, "write_explanation", "report"),
    ]
    before = [(module, name, getattr(module, name)) for module, name, _ in watched]
    _cached_envelope.cache_clear()
    begin = time.process_time()
    try:
        for module, name, step in watched:
            setattr(module, name, booked(step, getattr(module, name)))
        recording = booked("read", read_recording)(path)
        board = recording.board_ids[0]
        with tempfile.TemporaryDirectory() as out:
            explanation = explain_board.explain_board([recording], board)
            written = explain_board.write_explanation(Path(out), explanation)
    finally:
        for module, name, original in before:
            setattr(module, name, original)
    total = time.process_time() - begin
    spent["all else"] = total - sum(spent.values())
    return spent, [cause.cause for cause in written.document.causes]


def measured(program: str, hide: tuple[str, ...], turns: int) -> dict[str, Any]:
    """Measure one run."""
    with tempfile.TemporaryDirectory() as folder:
        path = record(Path(folder), program, hide)
        steps(path)  # warm
        spent, named = steps(path)
        return {"hidden": len(hide), **whole(path, turns), "steps_s": spent, "named": named}


def shown(name: str, bar_s: float, case: dict[str, Any]) -> str:
    """One run's figures as lines."""
    missed = "" if case["wall_s"] < bar_s else f"  MISSED the bar of {bar_s:.0f} s"
    each = ", ".join(f"{step} {1e3 * spent:.0f}" for step, spent in case["steps_s"].items())
    return (
        f"{name:<14} wall {case['wall_s']:6.2f} s, processor {case['processor_s']:6.2f} s{missed}\n"
        f"  in process, ms: {each}\n  named: {', '.join(case['named']) or 'nothing'}"
    )


def main() -> int:
    """Measure and print; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description="time of gyrorig explain")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--only", help="one program, plain")
    parser.add_argument("--out", type=Path, help="write the figures there")
    asked = parser.parse_args()
    programs = sorted(p.stem for p in (ROOT / "config" / "programs").glob("*.yaml"))
    runs: list[tuple[str, str, tuple[str, ...], float]] = [
        (program, program, (), PLAIN_S) for program in programs if asked.only in (None, program)
    ]
    if asked.only is None:
        runs.append(("full, 8 causes", "full", EIGHT, EIGHT_S))
    figures, missed = {}, []
    for name, program, hide, bar_s in runs:
        figures[name] = measured(program, hide, 1 if hide else asked.turns)
        if figures[name]["wall_s"] >= bar_s:
            missed.append(name)
        print(shown(name, bar_s, figures[name]), flush=True)  # noqa: T201
    if asked.out:
        asked.out.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    if missed:
        print(f"the bar was missed by: {', '.join(missed)}")  # noqa: T201
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
