"""What must not be forgotten by a restart: a hold on all motion, and doubt about the steps.

What to use when: `Memory` once per process. A daemon that was restarted by systemd after a
fault must not move what the one before it had sworn not to; only `gyrorigd clear` and a
homing change that. A disk that refuses to remember is lived with: the process still knows.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gyrorig_daemon.service.files import write_whole

MAX_BYTES = 100_000
UNREADABLE = "what an earlier daemon knew of this rig cannot be read"


@dataclass(frozen=True, slots=True)
class Hold:
    """Why nothing moves until somebody has looked."""

    reason: str
    since_utc_s: float


class Memory:
    """The hold and the doubt, in a file."""

    def __init__(self, path: Path, utc_s: float) -> None:
        """Read what an earlier daemon left; what cannot be read is a hold.

        Args:
            path: of the file; none is as good as new.
            utc_s: now.
        """
        self._path = path
        self._hold: Hold | None = None
        self._steps_are_sure = True
        self.failures = 0
        try:
            with path.open("rb") as file:
                self._read(json.loads(file.read(MAX_BYTES)))
        except FileNotFoundError:
            pass
        except (OSError, ValueError, TypeError, KeyError, RecursionError):
            self._hold, self._steps_are_sure = Hold(UNREADABLE, utc_s), False

    @property
    def hold(self) -> Hold | None:
        """Why nothing moves, None where all may."""
        return self._hold

    @hold.setter
    def hold(self, hold: Hold | None) -> None:
        if hold != self._hold:
            self._hold = hold
            self._write()

    @property
    def steps_are_sure(self) -> bool:
        """False when the unit restarted, or met a limit, since it was homed."""
        return self._steps_are_sure

    @steps_are_sure.setter
    def steps_are_sure(self, are_sure: bool) -> None:
        if are_sure != self._steps_are_sure:
            self._steps_are_sure = are_sure
            self._write()

    def _read(self, document: dict[str, Any]) -> None:
        hold = document["hold"]
        if hold is not None:
            self._hold = Hold(str(hold["reason"]), float(hold["since_utc_s"]))
        self._steps_are_sure = document["steps_are_sure"] is True

    def _write(self) -> None:
        hold = None if self._hold is None else asdict(self._hold)
        document = {"hold": hold, "steps_are_sure": self._steps_are_sure}
        try:
            write_whole(self._path, json.dumps(document).encode())
        except OSError:
            self.failures += 1
