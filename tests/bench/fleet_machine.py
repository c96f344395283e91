"""Commands run and measured with everything they start: time, processor time, memory.

What to use when: `measured(command)` for one command, whose pool, workers and helpers are
counted too, also those that outlive their parents: this process adopts them.
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
LOOK_S = 0.1


@dataclass(frozen=True, slots=True)
class CommandCost:
    """What a command took."""

    wall_s: float
    cpu_s: float
    worker_mb: float  # the largest process's share of memory, what it shares counted in part
    out: str
    err: str
    code: int


def adopt() -> None:
    """Become the parent of whoever loses theirs below this process."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def measured(command: Sequence[str], environment: Mapping[str, str] | None = None) -> CommandCost:
    """Run a command to its end and that of all it has started."""
    adopt()
    before, begun_s = _cpu_s(), time.monotonic()
    child = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    )
    most: list[float] = [0.0]
    end = threading.Event()
    looker = threading.Thread(target=_look, args=(end, most))
    looker.start()
    out, err = child.communicate()
    wall_s = time.monotonic() - begun_s
    end.set()
    looker.join()
    reap()
    return CommandCost(wall_s, _cpu_s() - before, most[0], out, err, child.returncode)


def reap() -> None:
    """Wait for all adopted children."""
    while True:
        try:
            os.wait()
        except ChildProcessError:
            return


def _cpu_s() -> float:
    used = getrusage(RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _look(end: threading.Event, most: list[float]) -> None:
    while not end.wait(LOOK_S):
        most[0] = max([most[0], *(pss_mb(pid) for pid in below(os.getpid()))])


def below(parent: int) -> list[int]:
    """Return the processes below one, itself left out."""
    parents: dict[int, int] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        parents[int(folder.name)] = int(fields[1])
    processes = {parent}
    while more := {pid for pid, above in parents.items() if above in processes} - processes:
        processes |= more
    return sorted(processes - {parent})


def pss_mb(pid: int) -> float:
    """Return the memory of a process; 0 where it is gone."""
    try:
        for line in (Path("/proc") / str(pid) / "smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) / 1024.0
    except OSError:
        pass
    return 0.0


def timed(work: Callable[[], object]) -> float:
    """Return the processor's seconds that this process spends on `work`, least of three."""
    took = []
    for _ in range(3):
        begun_s = time.process_time()
        work()
        took.append(time.process_time() - begun_s)
    return min(took)
