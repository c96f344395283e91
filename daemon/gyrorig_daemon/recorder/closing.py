"""Closing a recording while everything else goes on: a disk may take its time.

What to use when: `Closing` where ports and a watchdog have to be served meanwhile.
"""

import threading
from pathlib import Path

from gyrorig_daemon.recorder.recorder import Recorder


class Closing:
    """A recorder that closes in a thread of its own."""

    def __init__(self, recorder: Recorder, patience_s: float) -> None:
        """Begin to close; it is given up after `patience_s`."""
        self._recorder = recorder
        self._patience_s = patience_s
        self._path: Path | None = None
        self._fault: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="closing", daemon=True)
        self._thread.start()

    def is_alive(self) -> bool:
        """Return whether it is not closed yet."""
        return self._thread.is_alive()

    def path(self) -> Path:
        """Wait for the end and return the recording's name.

        Raises:
            MachineError: the disk refused.
        """
        self._thread.join()
        if self._fault is not None:
            raise self._fault
        if self._path is None:
            raise AssertionError("closed without a path")  # a fault of this program
        return self._path

    def _run(self) -> None:
        try:
            self._path = self._recorder.close(self._patience_s)
        except BaseException as fault:  # noqa: BLE001, RUF100 - raised again in the waiting thread
            self._fault = fault
