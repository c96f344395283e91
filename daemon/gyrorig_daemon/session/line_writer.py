"""Writer of log lines and progress to standard error that delays nobody.

What to use when: `LineWriter` for everything that is printed while a unit may move. A terminal
that was stopped with Ctrl-S, or a pipe that nobody reads, blocks the thread of the writer and
nothing else. What exceeds the queue is dropped and counted.
"""

import contextlib
import os
import sys
import threading
from collections.abc import Callable
from queue import SimpleQueue
from types import TracebackType
from typing import Self

MAX_QUEUED = 1_000  # texts
CLOSE_TIMEOUT_S = 1.0


class LineWriter:
    """Writes texts from a thread of its own, in order; a context manager."""

    def __init__(self, on_drop: Callable[[], None] = lambda: None) -> None:
        """Prepare; the thread starts with the first text.

        Args:
            on_drop: called for every text that is dropped.
        """
        self._on_drop = on_drop
        self._queue: SimpleQueue[str | None] = SimpleQueue()  # its put takes no lock
        self._thread: threading.Thread | None = None
        self.dropped = 0  # texts

    def __enter__(self) -> Self:
        """Return the writer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write what is queued, for a second at most."""
        self.close()

    def write_line(self, text: str) -> None:
        """Write one line; line breaks become spaces, other control characters are escaped."""
        self.write(escape_controls(" ".join(text.split())) + "\n")

    def write(self, text: str) -> None:
        """Write a text as it is. It never waits."""
        if self._queue.qsize() >= MAX_QUEUED:
            self.dropped += 1
            self._on_drop()
            return
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="log", daemon=True)
            self._thread.start()
        self._queue.put(text)

    def close(self) -> None:
        """Write what is queued, for a second at most."""
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join(CLOSE_TIMEOUT_S)

    def _run(self) -> None:
        reported = 0
        is_open = True
        while is_open:
            queued = self._queue.get()
            is_open, text = queued is not None, queued or ""
            if self.dropped > reported:
                lost, reported = self.dropped - reported, self.dropped
                text = f"{lost} lines are missing here, because nobody read the log.\n{text}"
            # a log that cannot be written, as when the journal restarts, must not end us
            with contextlib.suppress(OSError, ValueError):
                _write_to_stderr(text)


def escape_controls(text: str) -> str:
    r"""Return a text whose control characters are visible, as in \x1b."""
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text
    )


def _write_to_stderr(text: str) -> None:
    """Write past the buffer of `sys.stderr`, whose lock would keep the interpreter from ending."""
    try:
        descriptor = sys.stderr.fileno()
    except (AttributeError, OSError, ValueError):  # closed, or replaced by an object in memory
        if sys.stderr is not None:
            sys.stderr.write(text)
            sys.stderr.flush()
        return
    data = text.encode("utf-8", "backslashreplace")
    while data:
        data = data[os.write(descriptor, data) :]
