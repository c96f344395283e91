"""A thread for slow disk operations: syncs, opening and closing files.

What to use when: under `part_writer`. The writer's thread submits a call and checks later
whether it is done, so that a sync of 200 ms delays nobody. Without a thread the call is made at
once, and its errors come back in the same way.
"""

import queue
import threading
import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class DiskJob(Generic[T]):
    """One call, in progress or done."""

    def __init__(self, work: Callable[[], T]) -> None:
        self._work = work
        self._result: list[T] = []
        self._ended = threading.Event()
        self.error: Exception | None = None
        self.duration_ns = 0

    @property
    def is_done(self) -> bool:
        """Whether `result` is available."""
        return self._ended.is_set()

    def wait(self) -> None:
        """Wait until it is done."""
        self._ended.wait()

    def result(self) -> T:
        """Return the result of the call, or raise its error."""
        if self.error is not None:
            raise self.error
        return self._result[0]

    def run(self) -> None:
        """Make the call; the error goes to the caller of `result`."""
        start_ns = time.monotonic_ns()
        try:
            self._result.append(self._work())
        except Exception as error:
            self.error = error
        self.duration_ns = time.monotonic_ns() - start_ns
        self._ended.set()


class DiskWorker:
    """Makes calls one after the other, in the order of submission."""

    def __init__(self, threaded: bool) -> None:
        self.threaded = threaded
        self._jobs: queue.SimpleQueue[DiskJob[Any] | None] = queue.SimpleQueue()
        self._job_start_ns: int | None = None
        self._thread: threading.Thread | None = None

    def submit(self, work: Callable[[], T]) -> DiskJob[T]:
        """Submit a call."""
        job = DiskJob(work)
        if not self.threaded:
            job.run()
            job.duration_ns = 0  # simulated time: the same seed must give the same bytes
            return job
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="disk", daemon=True)
            self._thread.start()
        self._jobs.put(job)
        return job

    def busy_ns(self) -> int:
        """Return how long the present call has taken so far, 0 between calls."""
        start_ns = self._job_start_ns
        return 0 if start_ns is None else time.monotonic_ns() - start_ns

    def close(self, timeout_s: float) -> bool:
        """End the thread after the submitted calls; False if that takes too long."""
        if self._thread is None:
            return True
        self._jobs.put(None)
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            self._job_start_ns = time.monotonic_ns()
            job.run()
            self._job_start_ns = None
