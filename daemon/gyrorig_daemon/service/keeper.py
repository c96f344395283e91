"""What becomes of recordings once they are made: recovery after a crash, and retention.

What to use when: `Keeper` once per process. Its thread first has a child process finish what
a crash has left (that reads whole files: not in the process that serves ports), then deletes
what the rig's document allows, at the start and once an hour. `make_room` does the latter
when a recorder needs it. Nothing here is waited for by anything that records.
"""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.config.service import ServiceSettings
from gyrorig_daemon.recorder import Recorder
from gyrorig_daemon.recorder.retention import RetentionRules, tidy
from gyrorig_daemon.service.keeping import recorder_settings, retention_rules
from gyrorig_daemon.service.state import StateFolder
from gyrorig_protocol.errors import GyrorigError

EVERY_S = 3_600.0
RECOVERY_LIMIT_S = 3_600.0
ENDING_S = 2.0


@dataclass(slots=True)
class KeeperCounts:
    """What was made of old recordings since the daemon's start."""

    recovered: int = 0
    not_recovered: int = 0
    recovered_lost_bytes: int = 0
    deleted: int = 0
    deleted_bytes: int = 0
    kept_for_calibrations: int = 0  # at the last look
    retention_failures: int = 0


class Keeper:
    """Recovery and retention in the folder of one daemon."""

    def __init__(
        self,
        state: StateFolder,
        settings: Callable[[], ServiceSettings],
        clock_is_sound: Callable[[], bool],
        log: Callable[[str], None],
    ) -> None:
        """Prepare; `begin` begins.

        Args:
            state: whose recordings.
            settings: of the configuration in force.
            clock_is_sound: whether ages can be trusted.
            log: told what was done.
        """
        self._state = state
        self._settings = settings
        self._clock_is_sound = clock_is_sound
        self._log = log
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._wanted = threading.Event()
        self._child: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._run, name="keeper", daemon=True)
        self.counts = KeeperCounts()
        self.recorder: Recorder | None = None  # whose files are being written

    def begin(self) -> None:
        """Begin with the recovery."""
        self._thread.start()

    def close(self) -> None:
        """Do no more; a recovery that is under way is given up, and begun anew next time."""
        self._ended.set()
        self._wanted.set()
        child = self._child
        if child is not None:
            child.kill()
        if self._thread.ident is not None:
            self._thread.join(ENDING_S)

    def lack(self) -> str:
        """Return why no recording can begin now, "" where one can; have room made if it may."""
        settings = self._settings()
        needed, free = recorder_settings(settings).resume_bytes, self._state.free_bytes()
        if not os.access(self._state.recordings, os.W_OK):
            return (
                f"{self._state.recordings} cannot be written to: give it to the daemon's user "
                "(chown), or look at its disk"
            )
        if free is None or free >= needed:
            return ""
        if settings.delete_when_full:
            self._wanted.set()
        return (
            f"{free / 1e9:.2f} GB are free for recordings, less than {needed / 1e9:.2f}: make "
            "room, and sessions begin by themselves"
        )

    def make_room(self) -> None:
        """Delete what may go, because less than the reserve is free."""
        self._tidy()

    def _run(self) -> None:
        self._recover()
        while not self._ended.is_set():
            self._tidy()
            self._wanted.wait(EVERY_S)
            self._wanted.clear()

    def _recover(self) -> None:
        if not any(self._state.recordings.glob("*.mcap.part")):
            return
        reserve = recorder_settings(self._settings()).reserve_bytes
        command = [sys.executable, "-m", "gyrorig_daemon", "recover", "--json"]
        command += ["--reserve", str(reserve), str(self._state.recordings)]
        try:
            self._child = subprocess.Popen(command, stdout=subprocess.PIPE)  # noqa: S603 - ourselves
            if self._ended.is_set():  # `close` came a moment ago, and saw no child to end
                self._child.kill()
            told, _ = self._child.communicate(timeout=RECOVERY_LIMIT_S)
            self._take_report(json.loads(told))
        except (OSError, ValueError, KeyError, TypeError, subprocess.TimeoutExpired) as fault:
            if self._child is not None:
                self._child.kill()
            if not self._ended.is_set():
                self.counts.not_recovered += 1
                self._log(
                    f"the recovery of unfinished recordings broke off: {fault}: the next start "
                    f"tries again; by hand: gyrorigd recover {self._state.recordings}"
                )
        finally:
            self._child = None

    def _take_report(self, report: dict[str, list[dict[str, str | int]]]) -> None:
        for one in report["recovered"]:
            self.counts.not_recovered += one["outcome"] == "failed"
            self.counts.recovered += one["recording"] is not None
            self.counts.recovered_lost_bytes += int(one["lost_bytes"])
            self._log(str(one["text"]))

    def _tidy(self) -> None:
        settings = self._settings()
        rules = retention_rules(settings)
        if rules == RetentionRules():
            return
        recorder = self.recorder
        keep = () if recorder is None else recorder.paths
        with self._lock:
            try:
                done = tidy(
                    self._state.recordings,
                    rules,
                    self._stores(settings),
                    keep,
                    clock_is_sound=self._clock_is_sound(),
                )
            except (GyrorigError, OSError) as fault:
                self.counts.retention_failures += 1
                self._log(f"no recording was deleted: {fault}")
                return
        self.counts.kept_for_calibrations = len(done.cited)
        self.counts.deleted += len(done.deleted)
        self.counts.deleted_bytes += done.deleted_bytes
        if done.deleted:
            self._log(
                f"{len(done.deleted)} recordings deleted by the rules of the rig's configuration, "
                f"{done.deleted_bytes / 1e6:.1f} MB"
            )

    def _stores(self, settings: ServiceSettings) -> list[Path]:
        """Return the folders of calibrations; one that was named must be there."""
        own = self._state.root / "calibrations"
        return [*([own] if own.is_dir() else []), *(Path(path) for path in settings.stores)]
