"""Kill the batch, its workers or its scheduler, and run batches on a bucket that refuses requests.

After each fault, the script runs one batch without disturbance and checks the store. The index
must contain one row for each session, the store must contain one version for each board, and the
verification of the store must find no fault. Otherwise the script exits with status 1.

Run: python tests/bench/fleet_faults.py [--boards 12] [--kills 20] [--only batch,workers,...]
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.bench_fleet import GYRORIG, MAKE_SCRIPT, batch_command, print_line, start_cluster
from tests.bench.fleet_machine import adopt_orphans, list_descendants
from tests.bench.s3_server import BUCKET, served

from gyrorig_solver.fleet.store import StoreIndex, verify
from gyrorig_solver.storage import storage_at

FOREIGN_FILES = 8  # number of files in the spool that are not recordings
Popen = subprocess.Popen[str]


def start_command(command: list[str], environment: Mapping[str, str] | None = None) -> Popen:
    """Start a command in a new session."""
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=environment,
    )


def wait_for_summary(child: Popen) -> tuple[dict[str, object], str]:
    """Wait for the end of a batch; return its summary and its errors."""
    out, err = child.communicate()
    return (json.loads(out) if out.strip() else {}), err


def kill_all(child: Popen) -> None:
    """Kill a batch and all its descendants."""
    for pid in [child.pid, *list_descendants(child.pid)]:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
    child.communicate()


def check_store(fault: str, store: str, boards: int, start_s: float) -> bool:
    """Count and print the contents of a store, and return whether they are correct."""
    storage = storage_at(store)
    index = StoreIndex(storage)
    rows = Counter(status for (status,) in index.query("SELECT status FROM rows"))
    keys, written = index.query("SELECT count(DISTINCT key), count(*) FROM all_rows")[0]
    report = verify(storage)
    is_correct = (
        rows == Counter(ok=boards, rejected=FOREIGN_FILES)
        and keys == boards + FOREIGN_FILES
        and report.versions == boards
        and not report.faults
    )
    print_line(
        f"| {fault} | {boards + FOREIGN_FILES} | {rows['ok']} ok, {rows['rejected']} rejected"
        f"{''.join(f', {n} {status}' for status, n in rows.items() if status[0] in 'fq')} "
        f"| {report.versions} | {written - keys} | {len(report.faults)} "
        f"| {time.monotonic() - start_s:.0f} | {'yes' if is_correct else 'NO'} |"
    )
    return is_correct


def kill_batch(spool: Path, store: Path, boards: int, kills: int) -> bool:
    """Kill the batch with its workers at random moments, and then run it until its end."""
    rng, start_s = random.Random(1), time.monotonic()
    summary = wait_for_summary(
        start_command(batch_command(spool, store.with_name("whole"), "--workers", "2"))
    )[0]
    elapsed_s, count = float(str(summary["elapsed_s"])), 0
    for _ in range(kills):
        child = start_command(batch_command(spool, store, "--workers", "2"))
        try:
            child.wait(rng.uniform(0.0, 1.5 * elapsed_s / 4))
            child.communicate()
        except subprocess.TimeoutExpired:
            kill_all(child)
            count += 1
    wait_for_summary(start_command(batch_command(spool, store, "--workers", "2")))
    return check_store(f"batch killed {count} times", str(store), boards, start_s)


def kill_workers(spool: Path, store: Path, boards: int, kills: int) -> bool:
    """Kill workers that have started a job, one after the other.

    The batch repeats a session once after the loss of its worker. If the batch solves all sessions
    before enough workers are killed, the function checks the store and continues with a new store.
    """
    rng, start_s = random.Random(2), time.monotonic()
    count = nights = 0
    all_correct = True
    while count < kills and nights < kills:
        nights += 1
        before = count
        child = start_command(
            batch_command(spool, store, "--workers", "2", "--retry", "quarantined")
        )
        while child.poll() is None and count < kills:
            workers = [pid for pid in list_descendants(child.pid) if _is_worker(pid)]
            if workers:
                time.sleep(rng.uniform(0.0, 0.8))
                try:
                    os.kill(rng.choice(workers), signal.SIGKILL)
                    count += 1
                except ProcessLookupError:
                    continue
            time.sleep(0.3)
        wait_for_summary(child)
        for _ in range(3):
            wait_for_summary(
                start_command(
                    batch_command(spool, store, "--workers", "2", "--retry", "quarantined")
                )
            )
        fault = f"worker killed {count - before} times, {count} in total"
        all_correct &= check_store(fault, str(store), boards, start_s)
        store.rename(store.with_name(f"{store.name}-{nights}"))
    return all_correct and count >= kills


def _is_worker(pid: int) -> bool:
    """Return whether a process is a fork of the fork server."""
    try:
        command = Path(f"/proc/{pid}/cmdline").read_bytes()
        threads = len(list(Path(f"/proc/{pid}/task").iterdir()))
    except OSError:
        return False
    parent_is_server = b"forkserver" in _read_parent_command(pid)
    return b"forkserver" in command and parent_is_server and threads >= 1


def _read_parent_command(pid: int) -> bytes:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return Path(f"/proc/{fields[1]}/cmdline").read_bytes()
    except OSError:
        return b""


def kill_scheduler(spool: Path, store: Path, boards: int, _kills: int) -> bool:
    """Kill the scheduler and its workers while they have jobs."""
    start_s = time.monotonic()
    with start_cluster(2) as (address, process):
        child = start_command(batch_command(spool, store, "--scheduler", address))
        journal = store / "journal"
        while child.poll() is None and not any(p.stat().st_size for p in journal.glob("*.jsonl")):
            time.sleep(0.02)
        for pid in [*list_descendants(process.pid), process.pid]:
            os.kill(pid, signal.SIGKILL)
        wait_for_summary(child)
    wait_for_summary(start_command(batch_command(spool, store, "--workers", "2")))
    return check_store("scheduler killed", str(store), boards, start_s)


def run_two_batches(spool: Path, store: Path, boards: int, _kills: int) -> bool:
    """Run two batches on one store at the same time."""
    start_s = time.monotonic()
    batches = [start_command(batch_command(spool, store, "--workers", "1")) for _ in range(2)]
    for child in batches:
        wait_for_summary(child)
    return check_store("two batches at once", str(store), boards, start_s)


def run_on_refusing_bucket(spool: Path, _store: Path, boards: int, kills: int) -> bool:
    """Run batches on an object store that refuses 5 % of all requests, and kill some batches."""
    rng, start_s = random.Random(3), time.monotonic()
    store = f"s3://{BUCKET}/store"
    with served(errors=0.05) as environment, tempfile.TemporaryDirectory() as folder:
        environment["XDG_CACHE_HOME"] = folder
        os.environ.update(environment)
        nights = killed = 0
        for number in range(kills // 4):
            child = start_command([GYRORIG, *_batch_arguments(spool, store)])
            nights += 1
            try:
                # every second batch is killed early, while it has jobs
                child.wait(60.0 if number % 2 else rng.uniform(1.0, 6.0))
                child.communicate()
            except subprocess.TimeoutExpired:
                kill_all(child)
                killed += 1
        for _ in range(8):
            summary = wait_for_summary(start_command([GYRORIG, *_batch_arguments(spool, store)]))[0]
            nights += 1
            if summary and summary["put_off"] == 0 and not summary.get("others"):
                break
            time.sleep(5.0)
        for _ in range(8):
            try:
                fault = f"a bucket that refuses 5 %, {nights} nights, {killed} killed"
                return check_store(fault, store, boards, start_s)
            except Exception as error:  # the bucket refused a listing
                print_line(f"repeat the check: {error}")
    return False


def _batch_arguments(spool: Path, store: str) -> list[str]:
    return ["batch", "--spool", str(spool), "--store", store, "--json", "--workers", "2"]


FAULTS: dict[str, Callable[[Path, Path, int, int], bool]] = {
    "batch": kill_batch,
    "workers": kill_workers,
    "scheduler": kill_scheduler,
    "two": run_two_batches,
    "bucket": run_on_refusing_bucket,
}


def main() -> int:
    """Run the selected faults; return the exit status."""
    parser = argparse.ArgumentParser(description="kill batches and check their stores")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "bench-fleet")
    parser.add_argument("--boards", type=int, default=12)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--only", default=",".join(FAULTS))
    options = parser.parse_args()
    adopt_orphans()
    fleet_folder = options.work / "quick"
    command = [sys.executable, str(MAKE_SCRIPT), "--out", str(fleet_folder)]
    command += ["--boards", str(options.boards), "--nights", "1", "--at-once", "1"]
    subprocess.run(command, check=True, capture_output=True)
    for number in range(FOREIGN_FILES):
        (fleet_folder / "spool" / f"foreign{number}.mcap").write_bytes(b"foreign %d" % number)
    print_line(
        "| fault | sessions | rows | versions | rows written twice | faults found | s | correct |"
    )
    print_line("|---|---|---|---|---|---|---|---|")
    all_correct = True
    for name in options.only.split(","):
        with tempfile.TemporaryDirectory() as folder:
            all_correct &= FAULTS[name](
                fleet_folder / "spool", Path(folder) / "store", options.boards, options.kills
            )
    return 0 if all_correct else 1


if __name__ == "__main__":
    sys.exit(main())
