"""One rig through the whole program: recorded, solved, and compared with the truth.

What to use when: `run_trial` for a row of figures; `read_calibration` and `compare` for a document
of another origin.
"""

import contextlib
import io
import math
import resource
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from tests.bench.accuracy.board import NAMES
from tests.bench.accuracy.profile import FloatArray
from tests.bench.rigs.recording_file import write_recording
from tests.bench.rigs.rig import draw_rig

K_95 = 1.959963984540054
SOLVE_LIMIT_S = 900.0
TOTAL_KEY = "uncertainty"  # the section of the total uncertainty, where the solver states it
LABELS = ("bias", "scale", "nonorthogonality", "misalignment")
Solver = Callable[[Path, Path], tuple[int, str]]  # recording, output folder -> exit code, text


def solve_in_process(options: Sequence[str]) -> Solver:
    """Return a solver that runs `gyrorig solve` in this process."""

    def solve(recording: Path, out: Path) -> tuple[int, str]:
        from gyrorig_solver.cli import run  # noqa: PLC0415 - a trial by program needs no solver

        output = io.StringIO()
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
            code = run(["--quiet", "solve", str(recording), "--out", str(out), *options])
        return code, output.getvalue()

    return solve


def solve_by_program(program: str, options: Sequence[str]) -> Solver:
    """Return a solver that starts a `gyrorig` program."""

    def solve(recording: Path, out: Path) -> tuple[int, str]:
        command = [program, "--quiet", "solve", str(recording), "--out", str(out), *options]
        try:
            process = subprocess.run(
                command, capture_output=True, text=True, check=False, timeout=SOLVE_LIMIT_S
            )
        except subprocess.TimeoutExpired:
            return 1, f"not done after {SOLVE_LIMIT_S:g} s"
        return process.returncode, process.stdout + process.stderr

    return solve


def run_trial(seed: int, is_persistent: bool, solver: Solver) -> dict[str, Any]:
    """Return the row of one rig, ready for JSON."""
    rig = draw_rig(seed, is_persistent)
    row = rig.description() | {"truth": rig.truth.tolist()}
    row["base_bias"] = rig.stream_truth.base_bias_rad_s.tolist()
    bias_parts = rig.stream_truth.bias_parts_rad_s
    with tempfile.TemporaryDirectory() as folder:
        recording, out = Path(folder, f"rig-{seed}.mcap"), Path(folder, "out")
        write_recording(rig, recording)
        del rig
        begun_s = _cpu_s()
        code, output = solver(recording, out)
        row |= {"exit_code": code, "cpu_s": round(_cpu_s() - begun_s, 2)}
        written = sorted(out.glob("*/v0001.yaml"))
        if not written:
            return row | {"failed": output.strip().splitlines()[-1:] or ["no output"]}
        row |= read_calibration(written[0])
    return row | {"truth": stated_truth(row["truth"], bias_parts, row["terms"])}


def stated_truth(
    truth: Sequence[float], bias_parts: Mapping[str, FloatArray], fitted: Sequence[str]
) -> list[float]:
    """Return the truth of what a calibration states, (13,).

    The calibration states the bias without the causes that it contains: y = G omega + b + causes,
    see docs/conventions.md. The bias of a cause that it does not contain is a part of b.

    Args:
        truth: with the mean reading at rest as the bias.
        bias_parts: what each cause adds to it.
        fitted: the causes of the calibration.
    """
    bias = np.array(truth[:3])
    for cause, part in bias_parts.items():
        if cause in fitted:
            bias = bias - part
    return [*bias.tolist(), *truth[3:]]


def read_calibration(path: Path) -> dict[str, Any]:
    """Return what a calibration document states, in the order of `NAMES`."""
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    parameters = document["parameters"]
    findings = document.get("findings") or {}
    return {
        "value": _row(parameters, "value"),
        "std": _row(parameters, "std"),
        **_uncertainty(document),
        "verdict": document["trust"]["verdict"],
        "reasons": document["trust"]["reasons"],
        "reduced_chi2": document["quality"].get("reduced_chi2"),
        "named": findings.get("causes") or [],
        "findings": findings.get("verdict"),
        "terms": document["solver"]["terms"][5:],
    }


def _cpu_s() -> float:
    """Return the processor time of this process and of those that it waited for."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def _row(parameters: Mapping[str, Any], key: str) -> list[float | None]:
    values: list[float | None] = []
    for group in LABELS:
        entries = parameters[group].get(key)
        values += entries if entries is not None else [None] * 3
    return [*values, parameters["time_offset"].get(key)]


def _uncertainty(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the total standard uncertainties and their intervals; None where none are stated.

    They are in a section `uncertainty` by parameter, or beside `std` without intervals.
    """
    parameters = document["parameters"]
    stated = (document.get(TOTAL_KEY) or {}).get("parameters")
    if stated:
        entries = [stated.get(name, {}) for name in NAMES]
        return {key: [entry.get(key) for entry in entries] for key in ("total", "interval")}
    if any(TOTAL_KEY in parameters[group] for group in LABELS):
        return {"total": _row(parameters, TOTAL_KEY), "interval": None}
    return {"total": None, "interval": None}


def sigmas(row: Mapping[str, Any], stated: str, truth: FloatArray | None = None) -> FloatArray:
    """Return the errors in stated standard uncertainties, nan where a value is null.

    Args:
        row: of `run_trial`.
        stated: `std` for type A, `total` for the total.
        truth: true values instead of the row's, shape (13,).
    """
    true = np.array(row["truth"] if truth is None else truth, dtype=np.float64)
    value = np.array(row["value"], dtype=np.float64)
    uncertainty = np.array(row[stated] or [math.nan] * len(NAMES), dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray((value - true) / np.where(uncertainty > 0.0, uncertainty, np.nan))


def with_base_bias(row: Mapping[str, Any]) -> FloatArray:
    """Return the truth with the bias of the base model: without the causes that add to it."""
    return np.array([*row["base_bias"], *row["truth"][3:]])
