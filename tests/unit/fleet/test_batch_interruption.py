"""Ctrl-C ends a batch with one exception, and its processes without a text."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from gyrorig_protocol.child_process import module_command
from gyrorig_solver.fleet.jobs import BatchSummary, SolveSettings, run_batch
from gyrorig_solver.fleet.jobs.interruption import remember_interruption
from gyrorig_solver.fleet.jobs.workers import WorkerPool
from gyrorig_solver.fleet.store import verify

# Of the workers: loading it takes time, as loading the solver does, and so does its job.
WORKER_MODULE = """
import pathlib, time

pathlib.Path(__file__).with_name("server").touch()
time.sleep(1.0)

def run_long_job(_job):
    pathlib.Path(__file__).with_name("worker").touch()
    time.sleep(600.0)
"""
# A thread sends Ctrl-C when the server of the workers loads modules, or when a worker runs a job.
BATCH_PROGRAM = """
import os, pathlib, signal, sys, threading, time
from gyrorig_solver.fleet.jobs import workers

def send_interruption(phase):
    while not pathlib.Path(__file__).with_name(phase).exists():
        time.sleep(0.01)
    if phase == "server":
        os.killpg(0, signal.SIGINT)
    else:  # this process must end the others
        os.kill(os.getpid(), signal.SIGINT)

if __name__ == "__main__":
    workers.PRELOADED_MODULES = ["worker_module"]
    pools = workers.local_pools(2, 1 << 32)
    threading.Thread(target=send_interruption, args=(sys.argv[1],)).start()
    try:
        from worker_module_job import run_long_job
        for pool in pools:
            pool.job_function = run_long_job
        list(workers.run_all([1, 2], pools))
    except KeyboardInterrupt:
        print("interrupted")
"""
JOB_MODULE = """
def run_long_job(job):
    from worker_module import run_long_job as run

    return run(job)
"""


@pytest.mark.parametrize("start_phase", ["server", "worker"])
def test_ctrl_c_ends_the_processes_without_a_traceback(tmp_path: Path, start_phase: str) -> None:
    """The output ends when the last process that can write to it has ended."""
    program = tmp_path / "interrupted_batch.py"
    program.write_text(BATCH_PROGRAM)
    (tmp_path / "worker_module.py").write_text(WORKER_MODULE)
    (tmp_path / "worker_module_job.py").write_text(JOB_MODULE)
    search_path = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    ended = subprocess.run(
        [sys.executable, str(program), start_phase],
        capture_output=True,
        text=True,
        timeout=300,
        start_new_session=True,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(search_path)},
    )
    assert (ended.stdout, ended.stderr, ended.returncode) == ("interrupted\n", "", 0)


def press_ctrl_c_in_a_library() -> None:
    with contextlib.suppress(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_a_swallowed_ctrl_c_is_raised_again() -> None:
    with pytest.raises(KeyboardInterrupt), remember_interruption():
        press_ctrl_c_in_a_library()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_background_job_still_ignores_ctrl_c() -> None:
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with remember_interruption() as interruption:
            signal.raise_signal(signal.SIGINT)
        assert not interruption.was_requested
    finally:
        signal.signal(signal.SIGINT, previous)


def test_a_batch_stops_at_a_swallowed_ctrl_c(tmp_path: Path, recorded: list[Path]) -> None:
    (tmp_path / "spool").mkdir()
    shutil.copy(recorded[0], tmp_path / "spool")
    calls: list[int] = []

    def show(summary: BatchSummary) -> None:
        calls.append(summary.finished)
        press_ctrl_c_in_a_library()

    with pytest.raises(KeyboardInterrupt):
        run_batch(
            tmp_path / "spool",
            tmp_path / "store",
            SolveSettings(solver_version="0.1.0", extend=()),
            [WorkerPool(lambda: ThreadPoolExecutor(1))],
            progress=show,
        )
    assert calls == [0]  # no session was started
    assert verify(tmp_path / "store").faults == ()


def test_a_batch_that_is_interrupted_prints_one_line(tmp_path: Path, recorded: list[Path]) -> None:
    """The signal comes at the first claim, while the server of the workers starts."""
    (tmp_path / "spool").mkdir()
    shutil.copy(recorded[0], tmp_path / "spool")
    store = tmp_path / "store"
    options = ["--spool", str(tmp_path / "spool"), "--store", str(store), "--workers", "2"]
    with subprocess.Popen(
        module_command("gyrorig_solver", "batch", *options),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as batch:
        while not list(store.glob("**/claims/*")):
            assert batch.poll() is None
            time.sleep(0.01)
        os.killpg(batch.pid, signal.SIGINT)
        output, errors = batch.communicate(timeout=300)
    assert (output, errors.strip(), batch.returncode) == ("", "gyrorig: stopped by Ctrl-C", 130)
    assert verify(store).faults == ()
