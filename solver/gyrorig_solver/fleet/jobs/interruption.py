"""Ctrl-C that a library cannot swallow.

Python raises KeyboardInterrupt wherever the main thread is. A callback of the garbage collector,
and a C library that clears errors, drop it; the batch would then run to its end. What to use
when: `remember_interruption` around the batch, and its `check` where the batch can stop.
"""

import contextlib
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from types import FrameType


@dataclass(slots=True)
class Interruption:
    """Whether Ctrl-C was pressed."""

    was_requested: bool = False

    def check(self) -> None:
        """Raise KeyboardInterrupt if Ctrl-C was pressed."""
        if self.was_requested:
            raise KeyboardInterrupt


@contextlib.contextmanager
def remember_interruption() -> Iterator[Interruption]:
    """Remember a Ctrl-C that comes while the block runs, and raise KeyboardInterrupt as usual.

    Another handler of SIGINT stays in place, also the one that ignores it in a background job.
    """
    interruption = Interruption()
    in_main_thread = threading.current_thread() is threading.main_thread()
    if not in_main_thread or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield interruption
        return

    def interrupt(_signal: int, _frame: FrameType | None) -> None:
        interruption.was_requested = True
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield interruption
        interruption.check()
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
