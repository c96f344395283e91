"""How much of this machine one piece of work may take.

What to use when: `limit_memory` once in each worker of one's own, `memory_limited` around a
piece of work in a process that others have begun, `deadline` around each piece of work.
"""

import contextlib
import faulthandler
import resource
import signal
import threading
from collections.abc import Iterator

HARD_FACTOR = 1.5  # the work is ended from outside Python so much later than from inside


class TooLongError(Exception):
    """The work took longer than its deadline."""


def limit_memory(memory_bytes: int) -> None:
    """Let this process have no more memory than that; it meets a MemoryError then."""
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard == resource.RLIM_INFINITY or hard > memory_bytes:
        resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, hard))


@contextlib.contextmanager
def memory_limited(memory_bytes: int) -> Iterator[None]:
    """Let this process have no more memory than that in the block, then as much as before."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    limit_memory(memory_bytes)
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@contextlib.contextmanager
def deadline(deadline_s: float) -> Iterator[None]:
    """Raise TooLongError in the block after that time; end the process a little later.

    Python's handlers run between its own instructions, in the main thread alone: a loop
    inside a library, and work in another thread, are ended by faulthandler's thread, which
    takes the process with it.
    """
    faulthandler.dump_traceback_later(HARD_FACTOR * deadline_s, exit=True)
    try:
        if threading.current_thread() is threading.main_thread():
            with _alarm(deadline_s):
                yield
        else:
            yield
    finally:
        faulthandler.cancel_dump_traceback_later()


@contextlib.contextmanager
def _alarm(deadline_s: float) -> Iterator[None]:
    """Raise TooLongError in the block after that time."""

    def too_long(_signal: int, _frame: object) -> None:
        raise TooLongError

    before = signal.signal(signal.SIGALRM, too_long)
    signal.setitimer(signal.ITIMER_REAL, deadline_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
