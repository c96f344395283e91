"""Record what processes did in the last seconds: ran, waited for a processor or for the disk.

What to use when: `ProcessMonitor` for processes of which one will be killed.
`ProcessMonitor.describe_activity` describes the activity of each process since a given time. The
kernel counts the running and waiting time of every thread (/proc/PID/task/TID/schedstat). The
monitor polls the state of every thread; in state D, a thread waits for the disk.
"""

import threading
import time
from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

SAMPLE_PERIOD_S = 0.05
HISTORY_S = 10.0


@dataclass(frozen=True, slots=True)
class _ProcessSample:
    time_s: float
    ran_s: float
    waited_s: float
    on_disk: bool


def _read_sample(pid: int, time_s: float) -> _ProcessSample:
    ran_ns = waited_ns = 0
    on_disk = False
    for task in Path(f"/proc/{pid}/task").iterdir():
        running_ns, waiting_ns, _ = (task / "schedstat").read_text().split()
        ran_ns, waited_ns = ran_ns + int(running_ns), waited_ns + int(waiting_ns)
        on_disk |= (task / "stat").read_text().rpartition(")")[2].split()[0] == "D"
    return _ProcessSample(time_s, ran_ns * 1e-9, waited_ns * 1e-9, on_disk)


class ProcessMonitor:
    """A thread that samples processes until it is closed; it also records gaps between samples."""

    def __init__(self, pids: dict[str, int]) -> None:
        """Start sampling.

        Args:
            pids: by the names that `describe_activity` prints.
        """
        self._pids = dict(pids)
        self._samples: dict[str, deque[_ProcessSample]] = {
            name: deque(maxlen=int(HISTORY_S / SAMPLE_PERIOD_S)) for name in pids
        }
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop sampling."""
        self._ended.set()
        self._thread.join()

    def describe_activity(self, since_s: float) -> str:
        """Return one line about the activity since a time of `time.monotonic`."""
        texts = []
        for name, samples in self._samples.items():
            recent = [sample for sample in samples if sample.time_s >= since_s - SAMPLE_PERIOD_S]
            if len(recent) < 2:
                texts.append(f"{name}: not sampled")
                continue
            first, last = recent[0], recent[-1]
            gap_s = max(b.time_s - a.time_s for a, b in pairwise(recent))
            texts.append(
                f"{name}: ran {last.ran_s - first.ran_s:.2f} s and waited for a processor "
                f"{last.waited_s - first.waited_s:.2f} s of {last.time_s - first.time_s:.2f} s, "
                f"waited for the disk in {sum(sample.on_disk for sample in recent)} of "
                f"{len(recent)} samples, "
                f"at most {gap_s:.2f} s between samples"
            )
        return "; ".join(texts)

    def _run(self) -> None:
        while not self._ended.wait(SAMPLE_PERIOD_S):
            for name, pid in self._pids.items():
                try:
                    self._samples[name].append(_read_sample(pid, time.monotonic()))
                except (OSError, ValueError):  # the process has ended
                    continue
