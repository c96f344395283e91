"""Threads for slow disk operations: syncs, opening and closing files.

What to use when: `DiskWorker` under `part_writer`. The writer's thread submits a call and checks
later whether it is done, so that a sync of 200 ms delays nobody. Without a thread the call is made
at once, and its errors come back in the same way. `call_in_thread` for one call in its own thread.

The threads are daemon threads, unlike those of `ThreadPoolExecutor`: a disk that never answers must
not keep the process alive.
"""

import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

T = TypeVar("T")


def call_in_thread(work: Callable[[], T], name: str) -> Future[T]:
    """Make one call in a separate thread."""
    future: Future[T] = Future()
    thread = threading.Thread(target=lambda: _call(work, future), name=name, daemon=True)
    thread.start()
    return future


class DiskWorker:
    """Makes calls one after the other, in the order of submission."""

    def __init__(self, threaded: bool) -> None:
        self.threaded = threaded
        self._calls: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._call_start_ns: int | None = None
        self._thread: threading.Thread | None = None

    def submit(self, work: Callable[[], T]) -> Future[T]:
        """Submit a call."""
        future: Future[T] = Future()
        if not self.threaded:
            _call(work, future)
            return future
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="disk", daemon=True)
            self._thread.start()
        self._calls.put(lambda: _call(work, future))
        return future

    def busy_ns(self) -> int:
        """Return how long the present call has taken so far, 0 between calls."""
        start_ns = self._call_start_ns
        return 0 if start_ns is None else time.monotonic_ns() - start_ns

    def close(self, timeout_s: float) -> bool:
        """End the thread after the submitted calls; False if that takes too long."""
        if self._thread is None:
            return True
        self._calls.put(None)
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (call := self._calls.get()) is not None:
            self._call_start_ns = time.monotonic_ns()
            call()
            self._call_start_ns = None


def _call(work: Callable[[], T], future: Future[T]) -> None:
    """Make a call; its result or its error goes to the reader of the future."""
    try:
        future.set_result(work())
    except BaseException as fault:
        future.set_exception(fault)
        if not isinstance(fault, Exception):  # Ctrl-C in a call that is made at once
            raise
