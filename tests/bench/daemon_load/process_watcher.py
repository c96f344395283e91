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


class ProcessWatcher:
    """Reads processor time and memory of a process and its children until it is stopped."""

    def __init__(self, pid: int, every_s: float = 2.0) -> None:
        self._pid, self._every_s = pid, every_s
        self.histories: dict[int, ProcessHistory] = {}
        self._ended = threading.Event()
        self._began_s = time.monotonic()
        self.watched_s = 0.0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(self._every_s):
            try:
                for pid in (self._pid, *children(self._pid)):
                    self._read(pid)
            except (OSError, IndexError):
                return  # the process has ended
            self.watched_s = time.monotonic() - self._began_s

    def _read(self, pid: int) -> None:
        cpu_s, rss_kb = usage(pid)
        history = self.histories.get(pid)
        if history is None:
            history = self.histories[pid] = ProcessHistory(_name(command(pid)), first_cpu_s=cpu_s)
        history.cpu_s = cpu_s - (history.first_cpu_s or 0.0)
        history.rss_kb.append(rss_kb)


def _name(command_line: str) -> str:
    if "ports.acquisition" in command_line:
        return "acquisition"
    if "emulate" in command_line:
        return "emulated unit"
    return "daemon"
