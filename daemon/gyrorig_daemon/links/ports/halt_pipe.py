"""The second way of a halt order: from any thread or signal to the acquisition process.

What to use when: one `HaltPipe` per process, as a context manager. `order` asks the acquisition
process to halt the unit by itself, while the event loop is busy, late or stopped. `catch_signals`
lets the C handler of Python write the number of each signal to the same pipe, before any Python
code runs. Orders to the unit that follow are refused until the event loop has been told.
"""

import contextlib
import os
import signal
from types import TracebackType
from typing import Self

ORDER = b"\0"  # no signal has this number
_READ_BYTES = 4096


class HaltPipe:
    """A pipe to the acquisition process; the writing end never blocks."""

    def __init__(self, halting_signals: frozenset[int] = frozenset()) -> None:
        """Open the pipe.

        Args:
            halting_signals: numbers of the signals that halt the unit.

        Raises:
            OSError: the process has too many open files.
        """
        self.halting_signals = halting_signals
        self.read_fd, self._write_fd = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._previous_wakeup_fd: int | None = None

    def __enter__(self) -> Self:
        """Return the pipe."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close both ends."""
        self.close()

    def order(self) -> None:
        """Order a halt. It never waits; a full pipe holds orders enough."""
        with contextlib.suppress(OSError):
            os.write(self._write_fd, ORDER)

    def catch_signals(self) -> None:
        """Pass on the numbers of signals; call it in the main thread."""
        self._previous_wakeup_fd = signal.set_wakeup_fd(self._write_fd, warn_on_full_buffer=False)

    def drain(self) -> None:
        """Discard orders that no acquisition process has read."""
        read_orders(self.read_fd)

    def close(self) -> None:
        """Stop to pass on signals and close both ends."""
        if self._previous_wakeup_fd is not None:
            signal.set_wakeup_fd(self._previous_wakeup_fd)
            self._previous_wakeup_fd = None
        os.close(self.read_fd)
        os.close(self._write_fd)


def read_orders(read_fd: int) -> bytes | None:
    """Return the orders in the pipe, None if its writer has ended."""
    try:
        return os.read(read_fd, _READ_BYTES) or None
    except BlockingIOError:
        return b""
