"""Close a recording in a thread, while ports and a watchdog are served."""

import threading
from pathlib import Path

from gyrorig_daemon.recorder.recorder import Recorder


class BackgroundClose:
    """Closes a recorder in its own thread."""

    def __init__(self, recorder: Recorder, timeout_s: float) -> None:
        """Start to close; give up after `timeout_s`."""
        self._recorder = recorder
        self._timeout_s = timeout_s
        self._path: Path | None = None
        self._fault: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="closing", daemon=True)
        self._thread.start()

    def is_alive(self) -> bool:
        """Return whether closing is in progress."""
        return self._thread.is_alive()

    def path(self) -> Path:
        """Wait for the end and return the path of the recording.

        Raises:
            MachineError: the disk failed.
        """
        self._thread.join()
        if self._fault is not None:
            raise self._fault
        if self._path is None:
            raise AssertionError("closed without a path")  # a bug of this program
        return self._path

    def _run(self) -> None:
        try:
            self._path = self._recorder.close(self._timeout_s)
        except BaseException as fault:  # noqa: BLE001, RUF100 - raised again in the waiting thread
            self._fault = fault
