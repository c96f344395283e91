"""Compare the paper's method with the project's on recordings of the emulated rig.

    python docs/paper/end_to_end.py

Records the programs `static`, `paper` and `full` with `gyrorigd record --simulated-time`, solves
them with `gyrorig solve` by both methods, and compares the results with the true values.
The paper's method also runs here in the reading of its Table 3, with the 100 s of `static` as its
static test, and on the reference that the project's solver makes: best time and best angles.
Takes about half a minute.
"""

import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
import yaml
from docs.markdown import Block, number, numbers, show, table

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.estimate import calibrate_as_printed
from gyrorig_solver.estimate.paper.paper_method import READING_OF_TABLE_3, BiasSource, PaperResult
from gyrorig_solver.reference import read_pan_tilt_reference

ROOT = Path(__file__).resolve().parents[2]
SEED = 1
BOARD = "GY80-1"  # config/rig.yaml
DONE, NOT_IDENTIFIABLE = 0, 4  # exit codes of `gyrorig solve`
MRAD = 1000.0


@dataclass(frozen=True, slots=True, eq=False)
class Arrays:
    """One recording in the form that the paper's method needs."""

    time_s: FloatArray  # (n,)
    rate_rad_s: FloatArray  # (n, 3)
    pan_rad: FloatArray  # (n,)
    tilt_rad: FloatArray  # (n,)


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """One program, recorded and solved."""

    program: str
    arrays: Arrays
    truth: dict[str, Any]  # of the board, as the emulator wrote it
    likelihood: dict[str, Any]  # gyrorig/calibration/1; empty for a recording without motion
    paper: dict[str, Any]


def _run(*command: str) -> None:
    process = subprocess.run(  # noqa: S603 - this project's own programs
        [sys.executable, "-m", *command], capture_output=True, text=True, check=False, cwd=ROOT
    )
    if process.returncode not in {DONE, NOT_IDENTIFIABLE}:
        raise RuntimeError(f"{' '.join(command)}\n{process.stderr}")


def _arrays(recording_path: Path, moving: bool) -> Arrays:
    recording = read_recording(recording_path)
    samples = load_samples(recording, BOARD)
    keep = samples.usable.copy()
    keep[1:] &= np.diff(samples.time_s) > 0.0
    time_s = samples.time_s[keep]
    if moving:
        pan, tilt = read_pan_tilt_reference(recording, samples.origin_ns).angles_rad(time_s)
    else:
        polled = recording.ptu_positions()
        pan, tilt = (np.full(time_s.size, np.median(polled[axis])) for axis in ("pan", "tilt"))
    return Arrays(time_s, samples.rate_rad_s[keep], pan, tilt)


def _solved(recording: Path, method: str) -> dict[str, Any]:
    store = recording.parent / f"{recording.stem}-{method}"
    _run("gyrorig_solver", "solve", str(recording), "--method", method, "--out", str(store))
    text = (store / BOARD / "v0001.yaml").read_text(encoding="utf-8")
    return dict(yaml.safe_load(text))


def _session(program: str, folder: Path) -> Session:
    truth = folder / f"{program}.truth.yaml"
    _run(
        *("gyrorig_daemon", "record", "--simulated-time", "--seed", str(SEED)),
        *("--config", "config/rig.yaml", "--program", f"config/programs/{program}.yaml"),
        *("--out", str(folder), "--session", program, "--truth", str(truth)),
    )
    recording = next(folder.glob(f"*_{program}.mcap"))
    moving = program != "static"
    return Session(
        program=program,
        arrays=_arrays(recording, moving),
        truth=yaml.safe_load(truth.read_text(encoding="utf-8"))["boards"][BOARD],
        likelihood=_solved(recording, "likelihood") if moving else {},
        paper=_solved(recording, "paper") if moving else {},
    )


@cache
def sessions() -> dict[str, Session]:
    """The three programs, recorded and solved once."""
    with tempfile.TemporaryDirectory() as folder:
        return {name: _session(name, Path(folder)) for name in ("static", "paper", "full")}


def as_tabled(program: str, bias: BiasSource) -> PaperResult:
    """The paper's method on `program`, with the recording `static` before it."""
    rest, test = sessions()["static"].arrays, sessions()[program].arrays
    later_s = test.time_s - test.time_s[0] + rest.time_s[-1] + 1.0
    static = np.arange(rest.time_s.size + later_s.size) < rest.time_s.size
    return calibrate_as_printed(
        np.concatenate((rest.time_s, later_s)),
        np.concatenate((rest.rate_rad_s, test.rate_rad_s)),
        np.concatenate((rest.pan_rad, test.pan_rad)),
        np.concatenate((rest.tilt_rad, test.tilt_rad)),
        static,
        reading=replace(READING_OF_TABLE_3, bias=bias),
    )


def _gain(rows: list[list[float | None]]) -> FloatArray:
    return np.array([[np.nan if v is None else v for v in row] for row in rows], dtype=np.float64)


def _column_errors(gain: FloatArray, truth: FloatArray, seen: BoolArray) -> list[str]:
    """Largest error of each column times 1000; a dash for a null column."""
    apart = MRAD * np.abs(gain - truth).max(axis=0)
    return [number(float(a), 2) if ok else "-" for a, ok in zip(apart, seen, strict=True)]


def recordings() -> str:
    """Table of the recordings."""
    rows = []
    for session in sessions().values():
        time_s = session.arrays.time_s
        span = f"{time_s[-1] - time_s[0]:.0f}"
        reach = [
            f"{np.degrees(angle.min()):.0f} to {np.degrees(angle.max()):.0f}"
            for angle in (session.arrays.pan_rad, session.arrays.tilt_rad)
        ]
        rows.append([f"`{session.program}`", span, str(time_s.size), *reach])
    return table(["program", "duration, s", "samples", "range of pan, °", "range of tilt, °"], rows)


def as_printed() -> str:
    """Failures that `gyrorig solve --method paper` reports."""
    rows = []
    for program in ("paper", "full"):
        reasons = sessions()[program].paper["trust"]["reasons"]
        named = ", ".join(f"`{reason.split(':')[0]}`" for reason in reasons)
        rows.append([f"`{program}`", sessions()[program].paper["trust"]["verdict"], named])
    return table(["program", "verdict", "failures"], rows)


def gains() -> str:
    """Largest error of each column of G, by each method."""
    rows = []
    for program in ("paper", "full"):
        session = sessions()[program]
        truth = np.array(session.truth["STM"])
        for bias in ("static", "quasi_static"):
            result = as_tabled(program, bias)
            seen = np.array([np.abs(row).max(initial=0.0) < 0.5 for row in result.unseen])
            off = np.degrees(result.bias_rad_s - np.array(session.truth["mean_bias_rad_s"]))
            words = f"paper's method, {bias.replace('_', '-')} bias"
            errors = _column_errors(result.STM, truth, seen)
            rows.append([f"`{program}`", words, *errors, numbers(off, 3)])
        document = session.likelihood
        gain = _gain(document["matrices"]["STM"])
        off = np.degrees(
            np.array(document["parameters"]["bias"]["value"], dtype=np.float64)
            - np.array(session.truth["mean_bias_rad_s"])
        )
        errors = _column_errors(gain, truth, np.isfinite(gain.sum(axis=0)))
        rows.append([f"`{program}`", "`gyrorig solve`", *errors, numbers(off, 3)])
    head = [
        "program",
        "method",
        "error of column x, 1e-3",
        "of column y, 1e-3",
        "of column z, 1e-3",
    ]
    return table([*head, "bias minus true bias x, y, z, °/s"], rows)


def _truths(session: Session) -> dict[str, FloatArray]:
    truth = session.truth
    T = np.array(truth["T"])
    return {
        "bias": np.array(truth["mean_bias_rad_s"]),
        "scale": np.array(truth["scale"]),
        "nonorthogonality": np.array([T[1, 0], T[2, 0], T[2, 1]]),
    }


def parameters() -> str:
    """Program `full`: true values, estimates, and differences in standard deviations."""
    session = sessions()["full"]
    tabled = as_tabled("full", "static")
    names = {"bias": "xyz", "scale": "xyz", "nonorthogonality": ("xy", "zx", "zy")}
    paper = {"bias": numbers(tabled.bias_rad_s).split(", ")}
    if tabled.S is not None and tabled.T is not None:
        T = tabled.T
        paper["scale"] = numbers(np.diag(tabled.S)).split(", ")
        paper["nonorthogonality"] = numbers([T[1, 0], T[2, 0], T[2, 1]]).split(", ")
    rows = []
    for group, truth in _truths(session).items():
        estimates = session.likelihood["parameters"][group]
        for index, part in enumerate(names[group]):
            value, std = estimates["value"][index], estimates["std"][index]
            rows.append(
                [
                    f"{group} {part}",
                    number(float(truth[index]), 5),
                    f"{number(value, 5)} ± {number(std, 5)}",
                    number((value - float(truth[index])) / std, 1),
                    paper.get(group, ["none"] * 3)[index],
                ]
            )
    head = ["parameter", "true value", "`gyrorig solve`", "difference in standard deviations"]
    return table([*head, "paper's method, static bias"], rows)


def verdicts() -> str:
    """Observable parameters and verdicts of `gyrorig solve`."""
    rows = []
    for program in ("paper", "full"):
        seen = sessions()[program].likelihood["observability"]
        trust = sessions()[program].likelihood["trust"]
        rows.append(
            [
                f"`{program}`",
                f"{seen['rank']} of {seen['of']}",
                trust["verdict"],
                ", ".join(seen["unobservable"]) or "none",
            ]
        )
    return table(["program", "observable parameters", "verdict", "unobservable"], rows)


BLOCKS: dict[str, Block] = {
    "end-to-end-recordings": recordings,
    "end-to-end-printed": as_printed,
    "end-to-end-gains": gains,
    "end-to-end-verdicts": verdicts,
    "end-to-end-parameters": parameters,
}

if __name__ == "__main__":
    show(BLOCKS)
