"""Resource limits of one job: memory and time.

What to use when: `limit_memory` once in each worker process of our own, `memory_limit` around a
job in a process that another program started, `deadline` around each job.
"""

import contextlib
import faulthandler
import resource
import signal
import threading
from collections.abc import Iterator

HARD_DEADLINE_FACTOR = 1.5  # when the process is ended, relative to the deadline
REPEAT_SHARE = 0.25  # of the deadline, between two alarms
MIN_REPEAT_S = 0.1  # long enough to leave the block


class DeadlineExceededError(Exception):
    """A job took longer than its deadline."""


def limit_memory(memory_bytes: int) -> None:
    """Limit the memory of this process; beyond it, a MemoryError is raised."""
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard == resource.RLIM_INFINITY or hard > memory_bytes:
        resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, hard))


@contextlib.contextmanager
def memory_limit(memory_bytes: int) -> Iterator[None]:
    """Limit the memory of this process while the block runs."""
    previous = resource.getrlimit(resource.RLIMIT_AS)
    limit_memory(memory_bytes)
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, previous)


@contextlib.contextmanager
def deadline(deadline_s: float) -> Iterator[None]:
    """Raise DeadlineExceededError in the block after that time; end the process a little later.

    Signal handlers of Python run between its instructions and in the main thread only. A loop
    inside a library, and a job in another thread, are ended by faulthandler's thread, which
    ends the process.
    """
    faulthandler.dump_traceback_later(HARD_DEADLINE_FACTOR * deadline_s, exit=True)
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
    def too_long(_signal: int, _frame: object) -> None:
        raise DeadlineExceededError

    previous = signal.signal(signal.SIGALRM, too_long)
    # Python drops an exception that is raised in a callback of the garbage collector, so that one
    # alarm can be lost.
    signal.setitimer(signal.ITIMER_REAL, deadline_s, max(REPEAT_SHARE * deadline_s, MIN_REPEAT_S))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous)
