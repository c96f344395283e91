"""Runs of the emulated rig: child processes that replay the orders of a recording.

The solver never imports the daemon. A run gives a recording, like that of a real rig, and the
noise-free rates of its sensors, which no real rig can give.

One process runs several draws in sequence, because its start takes about as long as the emulation
of a minute. There is one process per core at a time.

What to use when: `Simulator` for a rig file; `run_draws` for the draws of several of them.
"""

import json
import os
import subprocess
import threading
import zlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import numpy as np

from gyrorig_protocol.child_process import module_command
from gyrorig_protocol.errors import GyrorigError, UsageError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data import FloatArray

FIRST_SEED = 1_000_001  # the smallest seed of the sessions' noise; people do not choose such seeds
RUN_TIMEOUT_S = 600.0  # of one run; a recording of an hour takes about a minute
MIN_WORKERS, MAX_WORKERS = 2, 8
_THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class SimulationFailedError(GyrorigError):
    """The emulated rig could not replay the recording."""


@dataclass(frozen=True, slots=True)
class Simulator:
    """An emulated rig: its short name, its rig file, and further arguments of `gyrorigd record`."""

    name: str
    config: Path
    is_twin: bool = True  # it has a posterior to draw from
    arguments: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRun:
    """One replay."""

    draw: int
    recording: Recording
    rates: Mapping[str, FloatArray]  # arrays of `gyrorigd record --rates-of-session`


def run_draws(
    simulations: Sequence[tuple[Simulator, range]],
    measured: Recording,
    folder: Path,
    on_run: Callable[[], None],
) -> list[list[SimulatedRun]]:
    """Replay the commands of a recording once per draw; return the runs of each simulator in order.

    Each draw has separate parameters from the posterior and separate noise. Both follow from the
    checksum of the measured rates, because the p-values of different recordings would otherwise
    depend on the same simulated noise. The processes of all simulators run together, the longest
    first, so that no core waits for the last process of one simulator.

    Args:
        simulations: each emulated rig and the numbers of its draws. 0 has the best parameters.
        measured: the recording with the commands.
        folder: for the files of the runs, in a folder with the name of each simulator.
        on_run: called after each run, by one thread at a time.

    Raises:
        UsageError: the daemon is not installed.
        SimulationFailedError: a run ended with an error.
    """
    if find_spec("gyrorig_daemon") is None:
        raise UsageError(
            "the emulated rig is not installed, and twin-check needs it",
            "run `pip install gyrorig` to install it",
        )
    workers = min(MAX_WORKERS, max(MIN_WORKERS, os.cpu_count() or 1))
    parts = [
        (row, simulator, part)
        for row, (simulator, draws) in enumerate(simulations)
        for part in split_draws(draws, workers, simulator.is_twin)
    ]
    parts.sort(key=lambda part: len(part[2]), reverse=True)
    lock = threading.Lock()
    runs: list[list[SimulatedRun]] = [[] for _ in simulations]
    with ThreadPoolExecutor(workers) as pool:
        pending = [
            pool.submit(_run_part, simulator, measured, part, folder / simulator.name, on_run, lock)
            for _, simulator, part in parts
        ]
        try:
            for (row, _, part), future in zip(parts, pending, strict=True):
                runs[row] += [
                    SimulatedRun(draw, read_recording(path), rates)
                    for draw, (path, rates) in zip(part, future.result(), strict=True)
                ]
        finally:
            for future in pending:
                future.cancel()
    return [sorted(of_one, key=lambda run: run.draw) for of_one in runs]


def split_draws(draws: range, count: int, is_twin: bool) -> list[range]:
    """Return the draws in ranges of nearly equal lengths, one per process.

    Args:
        draws: consecutive numbers.
        count: number of processes at the same time.
        is_twin: draw 0 has the best parameters, so it gets a separate process, which cannot
            continue from it.
    """
    first = [draws[:1]] if is_twin and draws[:1] == range(1) else []
    rest = draws[len(first) :]
    bounds = [len(rest) * part // count for part in range(count + 1)]
    parts = [rest[begin:end] for begin, end in pairwise(bounds)]
    return first + [part for part in parts if len(part)]


def _run_part(
    simulator: Simulator,
    measured: Recording,
    draws: range,
    folder: Path,
    on_run: Callable[[], None],
    lock: threading.Lock,
) -> list[tuple[Path, dict[str, FloatArray]]]:
    """Run the emulated rig once per draw, in one process."""
    name = f"draws-{draws[0]}"
    offset = _checksum_rates(measured)
    first_draw = draws[0] + offset if draws[0] else 0
    out = folder / name
    out.mkdir(parents=True, exist_ok=True)
    command = [
        *module_command("gyrorig_daemon", "record", "--simulated-time", "--json"),
        *("--config", str(simulator.config), "--replay", str(measured.path)),
        *(("--draw", str(first_draw)) if simulator.is_twin else ()),
        *("--session-seed", str(draws[0] + FIRST_SEED + offset), "--session", name),
        *("--sessions", str(len(draws)), "--rates", str(out / "rates.npz")),
        "--rates-of-session",
        *("--out", str(out), *simulator.arguments),
    ]
    environment = {**os.environ, **dict.fromkeys(_THREAD_VARIABLES, "1")}
    recordings: list[Path] = []
    with (
        (out / "errors.txt").open("w+", encoding="utf-8") as errors,
        subprocess.Popen(  # noqa: S603 - our own interpreter, no shell
            command, stdout=subprocess.PIPE, stderr=errors, text=True, env=environment
        ) as process,
    ):
        timer = threading.Timer(RUN_TIMEOUT_S * len(draws), process.kill)
        timer.start()
        try:
            for line in process.stdout or ():
                document = json.loads(line)
                if "recording" not in document:  # an error, which the exit status reports
                    continue
                recordings.append(Path(document["recording"]))
                with lock:
                    on_run()
            code = process.wait()
        finally:
            timer.cancel()
            process.kill()
        if code:
            errors.seek(0)
            raise _failure(draws[min(len(recordings), len(draws) - 1)], code, errors.read())
    names = (
        [f"rates-{number}.npz" for number in range(1, len(draws) + 1)]
        if len(draws) > 1
        else ["rates.npz"]
    )
    return [(path, _read_rates(out / rates)) for path, rates in zip(recordings, names, strict=True)]


def _checksum_rates(recording: Recording) -> int:
    """Return a checksum of the first board's rates; names and dates of files do not change it."""
    counts = recording.imu_field(recording.board_ids[0], "gyro")
    return zlib.crc32(np.ascontiguousarray(counts).tobytes())


def _read_rates(path: Path) -> dict[str, FloatArray]:
    with np.load(path, allow_pickle=False) as arrays:
        return {name: np.asarray(arrays[name]) for name in arrays.files}


def _failure(draw: int, code: int, text: str) -> SimulationFailedError:
    """Return the error of a run, with the last line that it wrote."""
    if code < 0:
        return SimulationFailedError(
            f"the emulated rig was ended in draw {draw}, or took longer than "
            f"{RUN_TIMEOUT_S:.0f} s per draw",
            "check a shorter recording, or use fewer draws",
        )
    reason = text.strip().rpartition("\n")[2].removeprefix("gyrorigd: ")
    error = SimulationFailedError(
        f"the emulated rig could not replay the recording (draw {draw})",
        reason or "run `gyrorigd record --replay` with the same files to see the reason",
    )
    error.exit_code = code
    return error
