"""Measure the time, the CPU time and the memory of a command and all its descendants.

What to use when: `measure_command` for one command. The result includes its worker pool and its
helpers, also those that outlive their parents, because this process adopts them.
"""

import ctypes
import os
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage

PR_SET_CHILD_SUBREAPER = 36  # linux/prctl.h
SAMPLE_PERIOD_S = 0.1


@dataclass(frozen=True, slots=True)
class CommandCost:
    """The time and the memory that a command needed, and its output."""

    wall_s: float
    cpu_s: float
    worker_mb: float  # PSS of the largest process, with its part of shared memory
    out: str
    err: str
    code: int


def adopt_orphans() -> None:
    """Become the parent of all descendants of this process that lose their parents."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def measure_command(
    command: Sequence[str], environment: Mapping[str, str] | None = None
) -> CommandCost:
    """Run a command until it and all its descendants end, and measure it."""
    adopt_orphans()
    before_cpu_s, start_s = _children_cpu_s(), time.monotonic()
    child = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    )
    peak_mb: list[float] = [0.0]
    end = threading.Event()
    sampler = threading.Thread(target=_sample_memory, args=(end, peak_mb))
    sampler.start()
    out, err = child.communicate()
    wall_s = time.monotonic() - start_s
    end.set()
    sampler.join()
    reap_children()
    return CommandCost(
        wall_s, _children_cpu_s() - before_cpu_s, peak_mb[0], out, err, child.returncode
    )


def reap_children() -> None:
    """Wait for all adopted children."""
    while True:
        try:
            os.wait()
        except ChildProcessError:
            return


def _children_cpu_s() -> float:
    used = getrusage(RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _sample_memory(end: threading.Event, peak_mb: list[float]) -> None:
    while not end.wait(SAMPLE_PERIOD_S):
        peak_mb[0] = max([peak_mb[0], *(read_pss_mb(pid) for pid in list_descendants(os.getpid()))])


def list_descendants(parent: int) -> list[int]:
    """Return all descendants of a process."""
    parents: dict[int, int] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        parents[int(folder.name)] = int(fields[1])
    processes = {parent}
    while children := {pid for pid, ppid in parents.items() if ppid in processes} - processes:
        processes |= children
    return sorted(processes - {parent})


def read_pss_mb(pid: int) -> float:
    """Return the memory of a process, or 0 if it has ended."""
    try:
        for line in (Path("/proc") / str(pid) / "smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) / 1024.0
    except OSError:
        pass
    return 0.0


def measure_cpu_s(work: Callable[[], object]) -> float:
    """Return the least CPU time of three calls of `work` in this process."""
    times_s = []
    for _ in range(3):
        start_s = time.process_time()
        work()
        times_s.append(time.process_time() - start_s)
    return min(times_s)
