"""Worker process of this machine that Ctrl-C does not reach; the batch ends it instead.

A terminal sends Ctrl-C to every process of the batch. A worker, or the server that starts the
workers, would print a traceback. What to use when: `LocalExecutor` for each local pool;
`abandon_local_executor` when its result is not wanted any more.
"""

import contextlib
import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from multiprocessing import resource_tracker
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess
from typing import Any, ParamSpec, TypeVar

from gyrorig_solver.fleet.jobs.resource_limits import limit_memory

P = ParamSpec("P")
T = TypeVar("T")


class LocalExecutor(ProcessPoolExecutor):
    """A pool of one worker process that ignores Ctrl-C."""

    def __init__(self, context: ForkServerContext, memory_bytes: int) -> None:
        """Prepare the pool; its first job starts the worker."""
        super().__init__(
            1, mp_context=context, initializer=_prepare_worker, initargs=(memory_bytes,)
        )
        self._workers: set[BaseProcess] = set()
        self._last_future: Future[Any] | None = None

    def submit(self, function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        """Start one job; Ctrl-C waits until the worker has started."""
        others = set(multiprocessing.active_children())
        with _interruption_blocked():
            future = super().submit(function, *args, **kwargs)
            self._workers |= set(multiprocessing.active_children()) - others
            self._last_future = future
        return future

    def end_running_job(self) -> None:
        """End the worker if it runs a job. The store survives this, as it survives a kill."""
        if self._last_future is not None and not self._last_future.done():
            for worker in self._workers:
                worker.terminate()


def abandon_local_executor(executor: Executor) -> None:
    """Shut the pool down without waiting for its job."""
    if isinstance(executor, LocalExecutor):
        executor.end_running_job()  # first, because a cancelled job looks like a finished one
    executor.shutdown(wait=False, cancel_futures=True)


def _prepare_worker(memory_bytes: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_memory(memory_bytes)


@contextlib.contextmanager
def _interruption_blocked() -> Iterator[None]:
    """Delay Ctrl-C until the end of the block; processes that start in the block never get it.

    A child inherits the blocked signals of its parent, also before it can run Python code. A
    thread of a library, such as duckdb's, still receives the signal for this process, and Python
    would then raise KeyboardInterrupt in the block. Therefore the handler only remembers it.
    """
    # The resource tracker unblocks SIGINT when it starts, so it must run before.
    resource_tracker.ensure_running()
    handler = signal.getsignal(signal.SIGINT)
    is_handled = callable(handler) and threading.current_thread() is threading.main_thread()
    delayed_signals: list[int] = []
    if is_handled:
        signal.signal(signal.SIGINT, lambda number, _frame: delayed_signals.append(number))
    previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)
        if is_handled:
            signal.signal(signal.SIGINT, handler)
        if delayed_signals:
            signal.raise_signal(signal.SIGINT)
