"""Measure the time of `gyrorig explain` for each shipped program, and for a run with 8 causes.

The emulated rig runs each program in simulated time. The bench then runs the whole command several
times as a separate process, and reports the least wall time. This time contains the imports, the
reading, the search and the page. The bench measures each step in this process after a warm-up,
because a batch also runs many recordings in one process.

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
EIGHT_CAUSES = (
    *("backlash", "eccentricity", "clock_skew", "scale_quadratic"),
    *("motor_coupling", "ringing", "worm_error", "supply_hum"),
)
PLAIN_LIMIT_S, EIGHT_CAUSES_LIMIT_S = 2.0, 60.0  # wall time of the whole command
SEED = 3


def record_program(folder: Path, program: str, hide: tuple[str, ...] = ()) -> Path:
    """Record a program on the emulated rig with hidden causes."""
    command = [str(Path(sys.executable).with_name("gyrorigd")), "record", "--simulated-time"]
    command += ["--config", str(ROOT / "config" / "rig.yaml"), "--seed", str(SEED)]
    command += ["--program", str(ROOT / "config" / "programs" / f"{program}.yaml")]
    command += [word for cause in hide for word in ("--hide", cause)]
    subprocess.run([*command, "--out", str(folder)], check=True, capture_output=True)
    return next(folder.glob("*.mcap"))


def measure_command(path: Path, repeats: int) -> dict[str, float]:
    """Run the command several times; return its least wall time and CPU time."""
    command = [sys.executable, "-m", "gyrorig_solver", "explain", str(path)]
    # The command writes its bytecode once, as an installed command does.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    wall_s, cpu_s = [], []
    with tempfile.TemporaryDirectory() as out:
        for _ in range(repeats):
            before, start_s = os.times(), time.monotonic()
            process = subprocess.run(
                [*command, "--out", out], capture_output=True, check=False, env=environment
            )
            wall_s.append(time.monotonic() - start_s)
            after = os.times()
            cpu_s.append(
                after.children_user
                + after.children_system
                - before.children_user
                - before.children_system
            )
            if process.returncode not in (0, 4):
                raise RuntimeError(process.stderr.decode())
    return {"wall_s": min(wall_s), "processor_s": min(cpu_s)}


def measure_steps(path: Path) -> tuple[dict[str, float], list[str]]:
    """Return the CPU time of each step in this process, and the names of the reported causes."""
    steps_s: dict[str, float] = {}

    def time_calls(step: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> Any:
            start_s = time.process_time()
            try:
                return function(*args, **options)
            finally:
                steps_s[step] = steps_s.get(step, 0.0) + time.process_time() - start_s

        return call

    timed_functions = [
        (explain_board, "fit_base", "base fit"),
        (cause_search, "scan_catalogue", "score passes"),
        (candidate_fits, "fit_candidate", "exact fits"),
        (motion_space, "refit_with_terms", "fits of all"),
        (fit_explanation, "cross_validate_causes", "held-out gain"),
        (explain_board, "write_explanation", "report"),
    ]
    originals = [(module, name, getattr(module, name)) for module, name, _ in timed_functions]
    _cached_envelope.cache_clear()
    start_s = time.process_time()
    try:
        for module, name, step in timed_functions:
            setattr(module, name, time_calls(step, getattr(module, name)))
        recording = time_calls("read", read_recording)(path)
        board = recording.board_ids[0]
        with tempfile.TemporaryDirectory() as out:
            explanation = explain_board.explain_board([recording], board)
            written = explain_board.write_explanation(Path(out), explanation)
    finally:
        for module, name, original in originals:
            setattr(module, name, original)
    total_s = time.process_time() - start_s
    steps_s["all else"] = total_s - sum(steps_s.values())
    return steps_s, [cause.cause for cause in written.document.causes]


def measure_run(program: str, hide: tuple[str, ...], repeats: int) -> dict[str, Any]:
    """Measure the command and its steps for one recording."""
    with tempfile.TemporaryDirectory() as folder:
        path = record_program(Path(folder), program, hide)
        measure_steps(path)  # warm-up
        steps_s, reported_causes = measure_steps(path)
        return {
            "hidden": len(hide),
            **measure_command(path, repeats),
            "steps_s": steps_s,
            "named": reported_causes,
        }


def format_run(name: str, limit_s: float, run: dict[str, Any]) -> str:
    """Return the times of one run as lines of text."""
    missed = "" if run["wall_s"] < limit_s else f"  MISSED the limit of {limit_s:.0f} s"
    steps_ms = ", ".join(f"{step} {1e3 * step_s:.0f}" for step, step_s in run["steps_s"].items())
    return (
        f"{name:<14} wall {run['wall_s']:6.2f} s, CPU {run['processor_s']:6.2f} s{missed}\n"
        f"  steps in one process, ms: {steps_ms}\n"
        f"  reported causes: {', '.join(run['named']) or 'none'}"
    )


def main() -> int:
    """Measure and print all runs; return 1 if a run misses its limit."""
    parser = argparse.ArgumentParser(description="measure the time of gyrorig explain")
    parser.add_argument("--turns", type=int, default=3, help="repetitions of each plain run")
    parser.add_argument("--only", help="only this program, without hidden causes")
    parser.add_argument("--out", type=Path, help="write the results to this JSON file")
    options = parser.parse_args()
    programs = sorted(p.stem for p in (ROOT / "config" / "programs").glob("*.yaml"))
    runs: list[tuple[str, str, tuple[str, ...], float]] = [
        (program, program, (), PLAIN_LIMIT_S)
        for program in programs
        if options.only in (None, program)
    ]
    if options.only is None:
        runs.append(("full, 8 causes", "full", EIGHT_CAUSES, EIGHT_CAUSES_LIMIT_S))
    figures, missed = {}, []
    for name, program, hide, limit_s in runs:
        figures[name] = measure_run(program, hide, 1 if hide else options.turns)
        if figures[name]["wall_s"] >= limit_s:
            missed.append(name)
        print(format_run(name, limit_s, figures[name]), flush=True)  # noqa: T201
    if options.out:
        options.out.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    if missed:
        print(f"missed limits: {', '.join(missed)}")  # noqa: T201
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
