"""Processor time and memory of processes, read from /proc by a thread while they run."""

import os
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

TICKS_HZ = os.sysconf("SC_CLK_TCK")
PAGE_KB = os.sysconf("SC_PAGE_SIZE") // 1024


@dataclass
class ProcessHistory:
    """One process over time."""

    name: str
    cpu_s: float = 0.0  # since it was first seen
    rss_kb: list[int] = field(default_factory=list)
    first_cpu_s: float | None = None


def children(pid: int) -> list[int]:
    """Return the processes that `pid` has started."""
    identifiers: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        identifiers += [int(word) for word in task.read_text().split()]
    return identifiers


def command(pid: int) -> str:
    """Return how a process was called."""
    return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()


def usage(pid: int) -> tuple[float, int]:
    """Return processor seconds and resident kB of a process."""
    text = Path(f"/proc/{pid}/stat").read_text()
    fields = text.rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_HZ, int(fields[21]) * PAGE_KB


class Watcher:
    """Looks at a process and its children until it is stopped."""

    def __init__(self, pid: int, every_s: float = 2.0) -> None:
        self._pid, self._every_s = pid, every_s
        self.seen: dict[int, ProcessHistory] = {}
        self._ended = threading.Event()
        self.began_s = time.monotonic()
        self.lasted_s = 0.0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End looking."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(self._every_s):
            try:
                for pid in (self._pid, *children(self._pid)):
                    self._look(pid)
            except (OSError, IndexError):
                return  # it has ended
            self.lasted_s = time.monotonic() - self.began_s

    def _look(self, pid: int) -> None:
        cpu_s, rss_kb = usage(pid)
        seen = self.seen.get(pid)
        if seen is None:
            seen = self.seen[pid] = ProcessHistory(_name(command(pid)), first_cpu_s=cpu_s)
        seen.cpu_s = cpu_s - (seen.first_cpu_s or 0.0)
        seen.rss_kb.append(rss_kb)


def _name(called: str) -> str:
    if "ports.acquisition" in called:
        return "acquisition"
    if "emulate" in called:
        return "emulated unit"
    return "daemon"
