"""How long processes stood still, and why, in the last seconds: a witness beside them.

What to use when: `Witness` beside a process that is going to be killed; `busy_text` says what each
of the processes did in a span of time: ran, waited for a processor, or slept on the disk.
The kernel counts the first two for every thread (/proc/PID/task/TID/schedstat); the third is
the state D, looked at.
"""

import threading
import time
from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

EVERY_S = 0.05
KEPT_S = 10.0


@dataclass(frozen=True, slots=True)
class _Look:
    at_s: float
    ran_s: float
    waited_s: float
    on_disk: bool


def _look(pid: int, at_s: float) -> _Look:
    ran = waited = 0
    on_disk = False
    for task in Path(f"/proc/{pid}/task").iterdir():
        running_ns, two, _ = (task / "schedstat").read_text().split()
        ran, waited = ran + int(running_ns), waited + int(two)
        on_disk |= (task / "stat").read_text().rpartition(")")[2].split()[0] == "D"
    return _Look(at_s, ran * 1e-9, waited * 1e-9, on_disk)


class Witness:
    """Looks at some processes until it is closed; itself may be kept waiting, and says so."""

    def __init__(self, pids: dict[str, int]) -> None:
        """Begin to look.

        Args:
            pids: by the names that `busy_text` uses.
        """
        self._pids = dict(pids)
        self._looks: dict[str, deque[_Look]] = {
            name: deque(maxlen=int(KEPT_S / EVERY_S)) for name in pids
        }
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Look no more."""
        self._ended.set()
        self._thread.join()

    def busy_text(self, since_s: float) -> str:
        """Return in one line what they did since a time of `time.monotonic`."""
        words = []
        for name, looks in self._looks.items():
            recent = [look for look in looks if look.at_s >= since_s - EVERY_S]
            if len(recent) < 2:
                words.append(f"{name}: not seen")
                continue
            first, last = recent[0], recent[-1]
            gap_s = max(b.at_s - a.at_s for a, b in pairwise(recent))
            words.append(
                f"{name}: ran {last.ran_s - first.ran_s:.2f} s and waited for a processor "
                f"{last.waited_s - first.waited_s:.2f} s of {last.at_s - first.at_s:.2f} s, "
                f"on the disk in {sum(look.on_disk for look in recent)} of {len(recent)} looks, "
                f"{gap_s:.2f} s apart at most"
            )
        return "; ".join(words)

    def _run(self) -> None:
        while not self._ended.wait(EVERY_S):
            for name, pid in self._pids.items():
                try:
                    self._looks[name].append(_look(pid, time.monotonic()))
                except (OSError, ValueError):  # it has ended
                    continue
