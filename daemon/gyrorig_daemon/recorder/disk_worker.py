"""A thread for what may take the disk long: syncs, opening and closing files.

What to use when: under `spool`. The writer's thread hands over a call and looks later
whether it is done; a sync of 200 ms then delays nobody. Without a thread the call is made
at once, and its errors come back in the same way.
"""

import queue
import threading
import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class Job(Generic[T]):
    """One call, under way or done."""

    def __init__(self, work: Callable[[], T]) -> None:
        self._work = work
        self._result: list[T] = []
        self._ended = threading.Event()
        self.error: Exception | None = None
        self.took_ns = 0

    @property
    def done(self) -> bool:
        """Whether `result` may be asked for."""
        return self._ended.is_set()

    def wait(self) -> None:
        """Wait until it is done."""
        self._ended.wait()

    def result(self) -> T:
        """Return what the call gave, or raise what it raised."""
        if self.error is not None:
            raise self.error
        return self._result[0]

    def run(self) -> None:
        """Make the call; whoever asks for the result gets the error."""
        begun_ns = time.monotonic_ns()
        try:
            self._result.append(self._work())
        except Exception as error:
            self.error = error
        self.took_ns = time.monotonic_ns() - begun_ns
        self._ended.set()


class DiskWorker:
    """Makes calls one after the other, in the order in which they were handed over."""

    def __init__(self, threaded: bool) -> None:
        self.threaded = threaded
        self._jobs: queue.SimpleQueue[Job[Any] | None] = queue.SimpleQueue()
        self._begun_ns: int | None = None
        self._thread: threading.Thread | None = None

    def submit(self, work: Callable[[], T]) -> Job[T]:
        """Have a call made."""
        job = Job(work)
        if not self.threaded:
            job.run()
            job.took_ns = 0  # no time passes there: a recording of one seed is the same bytes
            return job
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="disk", daemon=True)
            self._thread.start()
        self._jobs.put(job)
        return job

    def busy_ns(self) -> int:
        """How long the present call has taken so far, 0 between calls."""
        begun_ns = self._begun_ns
        return 0 if begun_ns is None else time.monotonic_ns() - begun_ns

    def close(self, patience_s: float) -> bool:
        """End the thread behind what was handed over; False if that takes too long."""
        if self._thread is None:
            return True
        self._jobs.put(None)
        self._thread.join(patience_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            self._begun_ns = time.monotonic_ns()
            job.run()
            self._begun_ns = None
