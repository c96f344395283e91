"""Worker pools that survive the death of a worker: every job ends with exactly one result.

What to use when: `run_all(jobs, pools)` for all jobs of a batch; `local_pools` for processes on
this machine. The loop uses `concurrent.futures.Executor` only, so it works with any executor.

A process pool of the standard library breaks completely when one of its workers dies, and does
not tell whose job killed it (see docs/decisions/0032). Therefore each local pool has one worker: a
death is attributed to the job that the pool was running, and the pool starts a new worker.

A terminal sends Ctrl-C to every process of the batch. The local workers, and the server that
starts them, do not receive it, because they would print tracebacks; the batch ends them.
"""

import contextlib
import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess
from typing import Any, ParamSpec, TypeVar

from gyrorig_protocol.child_process import protect_children
from gyrorig_protocol.errors import MachineError
from gyrorig_solver.fleet.jobs.resource_limits import limit_memory
from gyrorig_solver.fleet.jobs.session_job import Job, JobResult, failure_row, run_job

MAX_WORKER_DEATHS = 1  # after the second one, the job is quarantined
LOSS_POLL_S = 2.0  # interval of the check for lost pools
PRELOADED_MODULES = ["gyrorig_solver.fleet.jobs.session_job", "gyrorig_solver.pipeline.solve_board"]


P = ParamSpec("P")
T = TypeVar("T")


def _never_lost() -> bool:
    return False


def _shut_down(executor: Executor) -> None:
    executor.shutdown(wait=False, cancel_futures=True)


@dataclass(slots=True)
class WorkerPool:
    """An executor that is created again after its workers have died.

    `death_exceptions` are raised by its futures when a worker has died. `capacity` is the number
    of jobs that it is given at once. If that is more than one, a death can be reported for jobs
    that only waited next to the one that caused it; such jobs are repeated at the end, alone.
    """

    make_executor: Callable[[], Executor]
    capacity: int = 1
    death_exceptions: tuple[type[BaseException], ...] = (BrokenProcessPool,)
    max_attempts: int = MAX_WORKER_DEATHS + 1  # per job
    job_function: Callable[[Job], JobResult] = run_job
    abandon_executor: Callable[[Executor], None] = _shut_down
    is_lost: Callable[[], bool] = _never_lost  # its futures will never end
    executor: Executor | None = None
    running_jobs: dict["Future[JobResult]", Job] = field(default_factory=dict)

    def submit(self, job: Job) -> None:
        """Start one job."""
        if self.executor is None:
            self.executor = self.make_executor()
        try:
            future = self.executor.submit(self.job_function, job)
        except BrokenProcessPool:  # its idle worker died
            self.discard_executor()
            self.executor = self.make_executor()
            future = self.executor.submit(self.job_function, job)
        self.running_jobs[future] = job

    def discard_executor(self) -> None:
        """Abandon the executor; the next job creates another one."""
        if self.executor is not None:
            self.abandon_executor(self.executor)
        self.executor = None


@dataclass(frozen=True, slots=True)
class DeferredJob:
    """A job that was not done and not recorded, because the machine or the store refused."""

    job: Job
    fault: MachineError


class _LocalExecutor(ProcessPoolExecutor):
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


def _abandon_local_executor(executor: Executor) -> None:
    """Shut the pool down without waiting for its job."""
    if isinstance(executor, _LocalExecutor):
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


def local_pools(workers: int, memory_bytes: int) -> list[WorkerPool]:
    """Return pools of one process each on this machine.

    The processes are forked from a server that has loaded the solver once, so a new one takes
    milliseconds instead of the second for the imports.
    """
    protect_children()  # the server is started with `python -c`
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED_MODULES)

    def make() -> Executor:
        return _LocalExecutor(context, memory_bytes)

    return [WorkerPool(make, abandon_executor=_abandon_local_executor) for _ in range(workers)]


def _never_stopped() -> None:
    pass


def run_all(
    jobs: Iterable[Job],
    pools: list[WorkerPool],
    check_stop: Callable[[], None] = _never_stopped,
) -> Iterator[JobResult | DeferredJob]:
    """Yield the result of each job when it is ready.

    Jobs are taken one by one as pools become free, so `jobs` can be a generator. When the caller
    stops, or `check_stop` raises an exception, running jobs are abandoned.
    """
    new_jobs = iter(jobs)
    retries: list[Job] = []
    deaths: dict[str, int] = {}
    try:
        while True:
            check_stop()
            not_started = _fill_pools(pools, retries, new_jobs)
            yield from map(_deferred, not_started)
            futures = {future: pool for pool in pools for future in pool.running_jobs}
            if not futures and not not_started:
                return
            if not futures:
                continue
            finished, _ = wait(futures, timeout=LOSS_POLL_S, return_when=FIRST_COMPLETED)
            if not finished and (lost := [pool for pool in pools if pool.is_lost()]):
                yield from (_deferred(job) for pool in lost for job in pool.running_jobs.values())
                return
            for future in finished:
                pool = futures[future]
                job = pool.running_jobs.pop(future)
                result = _job_result(future, job, pool, deaths)
                if result is None:
                    retries.append(job)
                else:
                    yield result
    finally:
        for pool in pools:
            pool.discard_executor()


def _deferred(job: Job) -> DeferredJob:
    return DeferredJob(
        job,
        MachineError(
            "the worker processes of the batch have ended",
            "start the workers again, and then the batch",
        ),
    )


def _fill_pools(pools: list[WorkerPool], retries: list[Job], new_jobs: Iterator[Job]) -> list[Job]:
    """Give jobs to each pool up to its capacity; return the job that could not be started."""
    for pool in pools:
        while len(pool.running_jobs) < pool.capacity:
            job = _next_job(pool, retries, new_jobs)
            if job is None:
                break
            try:
                pool.submit(job)
            except Exception:  # the scheduler is gone, or no process can be started
                return [job]
    return []


def _next_job(pool: WorkerPool, retries: list[Job], new_jobs: Iterator[Job]) -> Job | None:
    """Return the next job for this pool, or None if it must first finish the current ones."""
    if retries and pool.capacity == 1:
        return retries.pop()
    job = next(new_jobs, None)
    if job is None and retries and not pool.running_jobs:  # alone, so that a death is its own
        return retries.pop()
    return job


def _job_result(
    future: "Future[JobResult]", job: Job, pool: WorkerPool, deaths: dict[str, int]
) -> JobResult | DeferredJob | None:
    """Return the result of a job; None if its worker died and the job is repeated."""
    try:
        return future.result()
    except MachineError as fault:
        return DeferredJob(job, fault)
    except pool.death_exceptions as fault:
        if not pool.running_jobs:  # a shared executor continues with other jobs
            pool.discard_executor()
        deaths[job.key] = deaths.get(job.key, 0) + 1
        if deaths[job.key] < pool.max_attempts:
            return None
        reason = f"the session ended its worker process repeatedly ({type(fault).__name__})"
        return JobResult(job.key, (failure_row(job, "quarantined", reason=reason),))
    except Exception:  # of the transport to the worker, such as a stopping scheduler
        return _deferred(job)
