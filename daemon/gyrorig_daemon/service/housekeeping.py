"""Housekeeping: recovery after a crash, leftover temporary files, and retention.

What to use when: one `Housekeeping` per process. Its thread first lets a child process recover
what a crash has left, because that reads whole files. Then it removes temporary files of killed
processes, and deletes what the rig's document permits, at the start and once per hour.
`free_space` does the same when a recorder needs space.
No recording waits for any of this.
"""

import json
import os
import subprocess
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.config.service_settings import ServiceSettings
from gyrorig_daemon.recorder import Recorder
from gyrorig_daemon.recorder.recovery import UNCLEAN_FOLDER
from gyrorig_daemon.recorder.retention import RetentionRules, apply_retention
from gyrorig_daemon.recorder.retention_memory import read_memory
from gyrorig_daemon.service.recording_policy import recorder_settings, retention_rules
from gyrorig_daemon.service.state_folder import StateFolder
from gyrorig_protocol.atomic_files import remove_leftovers
from gyrorig_protocol.child_process import module_command
from gyrorig_protocol.errors import GyrorigError

RETENTION_PERIOD_S = 3_600.0
RECOVERY_TIMEOUT_S = 3_600.0
JOIN_TIMEOUT_S = 2.0


@dataclass(slots=True)
class HousekeepingCounts:
    """Counters of recovery and retention since the start of the service."""

    recovered: int = 0
    not_recovered: int = 0
    recovered_lost_bytes: int = 0
    deleted: int = 0
    deleted_bytes: int = 0
    kept_for_calibrations: int = 0  # at the last check
    retention_failures: int = 0


class Housekeeping:
    """Recovery and retention in one state folder."""

    def __init__(
        self,
        state: StateFolder,
        settings: Callable[[], ServiceSettings],
        valid_utc_s: Callable[[], float | None],
        log: Callable[[str], None],
        metrics_path: Path | None = None,
    ) -> None:
        """Prepare; `start` starts the thread.

        Args:
            state: the folder with the recordings.
            settings: returns the settings of the configuration in force.
            valid_utc_s: returns the system time, None while it is not valid.
            log: writes a line to the log.
            metrics_path: file of the metrics.
        """
        self._state = state
        self._settings = settings
        self._valid_utc_s = valid_utc_s
        self._log = log
        self._metrics_path = metrics_path
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._wake = threading.Event()
        self._child: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._run, name="keeper", daemon=True)
        self.counts = HousekeepingCounts()
        self.recorder: Recorder | None = None  # whose files are being written
        self.protected: tuple[Path, ...] = ()  # recordings of a running experiment

    def start(self) -> None:
        """Start the thread, with the recovery first."""
        self._thread.start()

    def close(self) -> None:
        """Stop; a recovery in progress is aborted and repeated at the next start."""
        self._stopping.set()
        self._wake.set()
        child = self._child
        if child is not None:
            child.kill()
        if self._thread.ident is not None:
            self._thread.join(JOIN_TIMEOUT_S)

    def storage_problem(self) -> str:
        """Return why no recording can start, "" if one can; free space if that is permitted."""
        settings = self._settings()
        needed, free = recorder_settings(settings).resume_bytes, self._state.free_bytes()
        if not os.access(self._state.recordings, os.W_OK):
            return (
                f"the folder {self._state.recordings} is not writable. Give the folder to "
                "the user of the daemon with chown, or check the disk"
            )
        if free is None or free >= needed:
            return ""
        if settings.delete_when_full:
            self._wake.set()
        return (
            f"{free / 1e9:.2f} GB are free for recordings, and {needed / 1e9:.2f} GB are "
            "needed. Free disk space. Sessions then start without further action"
        )

    def free_space(self) -> None:
        """Delete what the rules permit, because less than the reserve is free."""
        self._apply_retention()

    def remove_leftovers(self) -> None:
        """Remove temporary files of processes that were killed while they wrote a small file."""
        state, queue = self._state, self._state.queue
        state_files = (state.schedule, state.persistent_state, state.retention_memory)
        files = [*state_files, *([] if self._metrics_path is None else [self._metrics_path])]
        for path in files:
            remove_leftovers(path.parent, path.name)
        remove_leftovers(queue, ".yaml")
        for folder in (queue / "done", queue / "failed", state.recordings / UNCLEAN_FOLDER):
            remove_leftovers(folder, ".json")

    def _run(self) -> None:
        self._recover()
        while not self._stopping.is_set():
            self.remove_leftovers()
            self._apply_retention()
            self._wake.wait(RETENTION_PERIOD_S)
            self._wake.clear()

    def _recover(self) -> None:
        if not any(self._state.recordings.glob("*.mcap.part")):
            return
        reserve_bytes = recorder_settings(self._settings()).reserve_bytes
        command = module_command("gyrorig_daemon", "recover", "--json")
        command += ["--reserve", str(reserve_bytes), str(self._state.recordings)]
        try:
            self._child = subprocess.Popen(command, stdout=subprocess.PIPE)  # noqa: S603 - own program
            if self._stopping.is_set():  # `close` was called before there was a child
                self._child.kill()
            output, _ = self._child.communicate(timeout=RECOVERY_TIMEOUT_S)
            self._count_recovered(json.loads(output))
        except (OSError, ValueError, KeyError, TypeError, subprocess.TimeoutExpired) as error:
            if self._child is not None:
                self._child.kill()
            if not self._stopping.is_set():
                self.counts.not_recovered += 1
                self._log(
                    f"The recovery of unfinished recordings failed ({error}). The daemon "
                    "tries again at its next start. To recover the recordings by hand, run "
                    f"gyrorigd recover {self._state.recordings}"
                )
        finally:
            self._child = None

    def _count_recovered(self, report: dict[str, list[dict[str, str | int]]]) -> None:
        for recovered in report["recovered"]:
            self.counts.not_recovered += recovered["outcome"] == "failed"
            self.counts.recovered += recovered["recording"] is not None
            self.counts.recovered_lost_bytes += int(recovered["lost_bytes"])
            self._log(str(recovered["text"]))

    def _apply_retention(self) -> None:
        settings = self._settings()
        rules = retention_rules(settings)
        if rules == RetentionRules():
            return
        recorder = self.recorder
        protected = (*self.protected, *(() if recorder is None else recorder.paths))
        with self._lock:
            try:
                result = apply_retention(
                    self._state.recordings,
                    rules,
                    self._calibration_stores(settings),
                    protected,
                    memory_path=self._state.retention_memory,
                    now_s=self._valid_utc_s(),
                )
            except (GyrorigError, OSError) as error:
                self.counts.retention_failures += 1
                self._log(f"No recording was deleted: {error}")
                return
        self.counts.kept_for_calibrations = len(result.cited)
        self.counts.deleted += len(result.deleted)
        self.counts.deleted_bytes += result.deleted_bytes
        if result.deleted:
            self._log(
                f"Deleted {len(result.deleted)} recordings ({result.deleted_bytes / 1e6:.1f} MB) "
                "by the retention rules of the rig's configuration."
            )

    def _calibration_stores(self, settings: ServiceSettings) -> list[Path]:
        """Return the calibration folders; each must exist that had citations or is in the settings.

        The store of the state folder can be empty: it is on the disk of the recordings.

        Raises:
            MachineError: the memory of the last check cannot be read.
        """
        state_store = self._state.root / "calibrations"
        memory = read_memory(self._state.retention_memory)
        is_filled = state_store.is_dir() and any(state_store.iterdir())
        is_needed = is_filled or memory.citation_counts.get(str(state_store), 0) > 0
        return [
            *([state_store] if is_needed else []),
            *(Path(path) for path in settings.stores),
        ]
