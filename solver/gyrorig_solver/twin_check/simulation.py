"""Runs of the emulated rig: child processes that replay the orders of a recording.

The solver never imports the daemon. A run gives a recording, like that of a real rig, and the
noise-free rates of its sensors, which no real rig can give.

What to use when: `Simulator` for a rig file; `run_draws` for several draws at the same time.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import GyrorigError, UsageError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data import FloatArray

FIRST_SEED = 1_000_001  # of the sessions' noise; unlike seeds that people choose
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
    rates: Mapping[str, FloatArray]  # the arrays of `gyrorigd record --rates`


def run_draws(
    simulator: Simulator,
    measured: Path,
    draws: range,
    folder: Path,
    on_run: Callable[[], None],
) -> Iterator[SimulatedRun]:
    """Replay the orders of a recording once per draw, and yield the runs in order.

    Each draw has its own parameters from the posterior and its own noise. One process per core
    runs at a time.

    Args:
        simulator: the emulated rig.
        measured: the recording with the orders.
        draws: numbers of the draws; also the seeds of their noise. 0 has the best parameters.
        folder: for the files of the runs.
        on_run: called after each run.

    Raises:
        UsageError: the daemon is not installed.
        SimulationFailedError: a run ended with an error.
    """
    if find_spec("gyrorig_daemon") is None:
        raise UsageError(
            "the emulated rig is not installed, and twin-check needs it",
            "install it with `pip install 'gyrorig[daemon]'`",
        )
    workers = min(MAX_WORKERS, max(MIN_WORKERS, os.cpu_count() or 1))
    with ThreadPoolExecutor(workers) as pool:
        pending = [
            pool.submit(_run_draw, simulator, measured, draw, folder / f"draw-{draw}")
            for draw in draws
        ]
        try:
            for draw, future in zip(draws, pending, strict=True):
                path, rates = future.result()
                on_run()
                yield SimulatedRun(draw, read_recording(path), rates)
        finally:
            for future in pending:
                future.cancel()


def _run_draw(
    simulator: Simulator, measured: Path, draw: int, folder: Path
) -> tuple[Path, dict[str, FloatArray]]:
    """Run the emulated rig once."""
    folder.mkdir(parents=True, exist_ok=True)
    rates_path = folder / "rates.npz"
    command = [
        *(sys.executable, "-m", "gyrorig_daemon", "record", "--simulated-time", "--json"),
        *("--config", str(simulator.config), "--replay", str(measured)),
        *(("--draw", str(draw)) if simulator.is_twin else ()),
        *("--session-seed", str(draw + FIRST_SEED), "--session", f"draw-{draw}"),
        *("--rates", str(rates_path), "--out", str(folder), *simulator.arguments),
    ]
    environment = {**os.environ, **dict.fromkeys(_THREAD_VARIABLES, "1")}
    try:
        result = subprocess.run(  # noqa: S603 - our own interpreter, no shell
            command,
            capture_output=True,
            text=True,
            check=False,
            timeout=RUN_TIMEOUT_S,
            env=environment,
        )
    except subprocess.TimeoutExpired as fault:
        raise SimulationFailedError(
            f"the emulated rig did not finish draw {draw} in {RUN_TIMEOUT_S:.0f} s",
            "check a shorter recording, or use fewer draws",
        ) from fault
    if result.returncode:
        raise _failure(draw, result)
    path = Path(json.loads(result.stdout)["recording"])
    with np.load(rates_path) as arrays:
        return path, {name: np.asarray(arrays[name]) for name in arrays.files}


def _failure(draw: int, result: subprocess.CompletedProcess[str]) -> SimulationFailedError:
    """Return the error of a run, with the last line that it wrote."""
    reason = result.stderr.strip().rpartition("\n")[2].removeprefix("gyrorigd: ")
    error = SimulationFailedError(
        f"the emulated rig could not replay the recording (draw {draw})",
        reason or "run `gyrorigd record --replay` with the same files to see the reason",
    )
    error.exit_code = result.returncode if result.returncode > 0 else 1
    return error
