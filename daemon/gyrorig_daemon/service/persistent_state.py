"""State that survives a restart: the motion lock, and whether the step count is reliable.

What to use when: one `PersistentState` per process. A service that systemd has restarted after
a fault must not move a unit that was locked before. Only `gyrorigd clear` and a homing change
that. If the file cannot be written, the process continues with the state in memory, and the
status timer writes the file again each second (`StateFile`).
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gyrorig_daemon.service.state_file import StateFile

MAX_STATE_FILE_BYTES = 100_000
UNREADABLE_STATE = "the daemon cannot read the state file of this rig"


@dataclass(frozen=True, slots=True)
class MotionLock:
    """The reason why nothing moves until a person releases the lock."""

    reason: str
    since_utc_s: float


class PersistentState:
    """The motion lock and the reliability of the step count, stored in a file."""

    def __init__(self, path: Path, utc_s: float) -> None:
        """Read the state of an earlier process; an unreadable file locks motion.

        Args:
            path: the file; a missing file means a new rig.
            utc_s: the present time.
        """
        self.file = StateFile(path)
        self._motion_lock: MotionLock | None = None
        self._steps_are_sure = True
        try:
            with path.open("rb") as file:
                self._read(json.loads(file.read(MAX_STATE_FILE_BYTES)))
        except FileNotFoundError:
            pass
        except (OSError, ValueError, TypeError, KeyError, RecursionError):
            self._motion_lock, self._steps_are_sure = MotionLock(UNREADABLE_STATE, utc_s), False

    @property
    def motion_lock(self) -> MotionLock | None:
        """The motion lock, None if motion is permitted."""
        return self._motion_lock

    @motion_lock.setter
    def motion_lock(self, motion_lock: MotionLock | None) -> None:
        self.store(motion_lock, self._steps_are_sure)

    @property
    def steps_are_sure(self) -> bool:
        """False if the unit has restarted, or met a limit, since it was homed."""
        return self._steps_are_sure

    @steps_are_sure.setter
    def steps_are_sure(self, sure: bool) -> None:
        self.store(self._motion_lock, sure)

    def store(self, motion_lock: MotionLock | None, steps_are_sure: bool) -> None:
        """Set both values, in one write."""
        if (motion_lock, steps_are_sure) != (self._motion_lock, self._steps_are_sure):
            self._motion_lock, self._steps_are_sure = motion_lock, steps_are_sure
            self._write()

    def _read(self, document: dict[str, Any]) -> None:
        motion_lock = document["hold"]
        if motion_lock is not None:
            self._motion_lock = MotionLock(
                str(motion_lock["reason"]), float(motion_lock["since_utc_s"])
            )
        self._steps_are_sure = document["steps_are_sure"] is True

    def _write(self) -> None:
        motion_lock = None if self._motion_lock is None else asdict(self._motion_lock)
        document = {"hold": motion_lock, "steps_are_sure": self._steps_are_sure}
        self.file.write(json.dumps(document).encode())
