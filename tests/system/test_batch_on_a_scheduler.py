"""A batch on dask's workers: the same ends as on this machine's, and nothing lost with it."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.system.conftest import Clusters

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.cli import run
from gyrorig_solver.fleet.store import StoreIndex, verify

pytest.importorskip("distributed", reason="dask.distributed is not installed: pip install .[fleet]")

CLUSTER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""
# Ten milliseconds each: some seconds of work are left when the first row is seen.
PIECES = 400
BATCH = [str(Path(sys.executable).with_name("gyrorig")), "batch", "--json"]


@dataclass
class Cluster:
    process: "subprocess.Popen[str]"
    address: str


# The jobs of a batch on a scheduler, one of which kills every worker that has it.
POISONED = """
import json, os, signal, sys
from pathlib import Path
from gyrorig_solver.fleet.jobs.dask_workers import dask_pools
from gyrorig_solver.fleet.jobs.session_job import (
    Job, JobResult, SolveSettings, failure_row, run_job_memory_limited
)
from gyrorig_solver.fleet.jobs.workers import run_all
from gyrorig_solver.storage.folder import Folder

address, folder = sys.argv[1], Path(sys.argv[2])

def work(job):
    with (folder / "begun").open("a") as file:
        file.write(job.key + "\\n")
    if job.key == "poison":
        os.kill(os.getpid(), signal.SIGKILL)
    return JobResult(job.key, (failure_row(job, "rejected", reason="as asked"),))

settings = SolveSettings(solver_version="0.1.0")
keys = ["k1", "k2", "poison", *(f"k{n}" for n in range(3, 12))]
storage = Folder(folder)
jobs = [Job(key, "night", storage, storage, (), ("00",), settings) for key in keys]
with dask_pools(address) as pools:
    (pool,) = pools
    limited = pool.job_function is run_job_memory_limited
    pool.job_function = work
    ended = [(result.key, result.rows[0].status) for result in run_all(jobs, pools)]
begun = (folder / "begun").read_text().split()
print(json.dumps({"ended": ended, "killed": begun.count("poison"), "limited": limited}))
"""


@pytest.fixture
def cluster(clusters: Clusters, request: pytest.FixtureRequest) -> Iterator[Cluster]:
    """One worker of a scheduler, which is told what the parameter says."""
    with clusters(CLUSTER, more=getattr(request, "param", {})) as (process, address):
        yield Cluster(process, address)


@pytest.fixture
def spool(tmp_path: Path, contracts: Path) -> Path:
    folder = tmp_path / "spool"
    folder.mkdir()
    shutil.copy(contracts / "sample.mcap", folder / "sample.mcap")
    for number in range(4):
        (folder / f"foreign{number}.mcap").write_bytes(b"%d" % number)
    return folder


@pytest.mark.long
def test_a_batch_on_a_scheduler_and_on_a_dying_one(
    cluster: Cluster, spool: Path, tmp_path: Path
) -> None:
    store = tmp_path / "store"
    command = [*BATCH, "--spool", str(spool), "--store", str(store)]
    process = subprocess.run(
        [*command, "--scheduler", cluster.address], capture_output=True, text=True, check=False
    )
    assert process.returncode == 5, process.stderr
    assert Counter(json.loads(process.stdout)["ended"]) == Counter(ok=1, rejected=4)
    assert verify(store).faults == ()

    for number in range(4, PIECES):
        (spool / f"foreign{number}.mcap").write_bytes(b"%d" % number)
    shutil.copy(spool / "sample.mcap", spool / "a-copy.mcap")  # the same bytes: no work
    child = subprocess.Popen(
        [*command, "--scheduler", cluster.address],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    while child.poll() is None and not has_rows(store):
        time.sleep(0.005)  # between looks; what is waited for is its first row
    os.killpg(cluster.process.pid, signal.SIGKILL)
    out, err = child.communicate()  # dask tries to find a lost scheduler for a while
    assert child.returncode == 5, err
    document = json.loads(out)
    assert document["put_off"] > 0  # what the scheduler held when it died
    assert document["put_off_why"].startswith("the worker processes of the batch have ended")
    here = subprocess.run(command, capture_output=True, text=True, check=False)
    assert here.returncode in (0, 5), here.stderr
    after = json.loads(here.stdout)
    assert after["done_before"] + sum(after["ended"].values()) == PIECES + 1
    assert after["put_off"] == 0
    assert (
        document["put_off"] + document["not_begun"] + sum(document["ended"].values()) == PIECES - 4
    )
    statuses = Counter(status for (status,) in StoreIndex(store).query("SELECT status FROM rows"))
    assert statuses == Counter(ok=1, rejected=PIECES)
    assert verify(store).faults == ()


def has_rows(store: Path) -> bool:
    """Return whether a journal that is there now has a row; it may be folded while we look."""
    for path in (store / "journal").glob("*.jsonl"):
        with contextlib.suppress(FileNotFoundError):
            if path.stat().st_size:
                return True
    return False


@pytest.mark.parametrize(
    ("cluster", "workers_killed"),
    [({"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}, 2)],
    indirect=["cluster"],
)
def test_only_the_job_that_kills_two_workers_is_quarantined(
    cluster: Cluster, tmp_path: Path, workers_killed: int
) -> None:
    """The scheduler tells a death to all that waited on that worker: those are tried alone."""
    command = [sys.executable, "-c", POISONED, cluster.address, str(tmp_path)]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    document = json.loads(process.stdout)
    ended = dict(document["ended"])
    assert len(document["ended"]) == len(ended) == 12
    assert ended.pop("poison") == "quarantined"
    assert set(ended.values()) == {"rejected"}
    assert document["killed"] == workers_killed
    assert document["limited"]


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("tcp://192.0.2.1:8786", "is not protected"),
        ("tcp://0.0.0.0:8786", "is not protected"),
        ("tls://192.0.2.1:8786", "needs TLS certificates"),
        ("127.0.0.1:8786", "is not an address of a scheduler"),
        ("tcp://127.0.0.1:99999999", "is not an address of a scheduler"),
    ],
)
def test_an_address_open_to_others_is_refused(address: str, words: str) -> None:
    from gyrorig_solver.fleet.jobs.dask_workers import dask_pools  # noqa: PLC0415

    with pytest.raises(UsageError, match=words), dask_pools(address):
        pass


def test_a_scheduler_that_local_users_can_reach_is_pointed_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It runs what any user of this computer sends, as its owner."""
    command = ["-v", "batch", "--spool", str(tmp_path), "--store", str(tmp_path / "s")]
    assert run([*command, "--scheduler", "tcp://127.0.0.1:1"]) == 75
    assert "Every user of this computer can run programs" in capsys.readouterr().err


def test_contradicting_options_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    base = ["batch", "--spool", str(tmp_path), "--store", str(tmp_path / "s")]
    assert run([*base, "--scheduler", "tcp://127.0.0.1:1", "--workers", "2"]) == 2
    assert "--workers and --scheduler cannot be used together" in capsys.readouterr().err
