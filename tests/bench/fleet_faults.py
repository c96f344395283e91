"""Nights on which everything dies: workers, the scheduler, the batch; and a bucket that errs.

Each ends with a night that is let alone, and a count: every session one row and one version,
nothing lost, nothing twice, and the store verifies. Leaves with 1 if not.

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

from tests.bench.bench_fleet import GYRORIG, MAKE, batch, cluster, say
from tests.bench.fleet_machine import adopt, below
from tests.bench.s3_server import BUCKET, served

from gyrorig_solver.fleet.store import StoreIndex, verify
from gyrorig_solver.storage import storage_at

FOREIGN = 8  # files in the spool that are no recordings
Popen = subprocess.Popen[str]


def begin(command: list[str], environment: Mapping[str, str] | None = None) -> Popen:
    """Begin a command in a session of its own."""
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=environment,
    )


def end(child: Popen) -> tuple[dict[str, object], str]:
    """Wait for a batch; return what it said."""
    out, err = child.communicate()
    return (json.loads(out) if out.strip() else {}), err


def kill(child: Popen) -> None:
    """Kill a batch with all that it has started."""
    for pid in [child.pid, *below(child.pid)]:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
    child.communicate()


def judged(what: str, store: str, boards: int, begun_s: float) -> bool:
    """Count what a store holds, say it, and return whether all is as it should be."""
    place = storage_at(store)
    index = StoreIndex(place)
    rows = Counter(status for (status,) in index.query("SELECT status FROM rows"))
    keys, written = index.query("SELECT count(DISTINCT key), count(*) FROM all_rows")[0]
    report = verify(place)
    whole = (
        rows == Counter(ok=boards, rejected=FOREIGN)
        and keys == boards + FOREIGN
        and report.versions == boards
        and not report.faults
    )
    say(
        f"| {what} | {boards + FOREIGN} | {rows['ok']} ok, {rows['rejected']} rejected"
        f"{''.join(f', {n} {status}' for status, n in rows.items() if status[0] in 'fq')} "
        f"| {report.versions} | {written - keys} | {len(report.faults)} "
        f"| {time.monotonic() - begun_s:.0f} | {'held' if whole else 'NOT'} |"
    )
    return whole


def kill_batch(spool: Path, store: Path, boards: int, kills: int) -> bool:
    """Kill the batch with its workers at random moments, then let it end."""
    chance, begun_s = random.Random(1), time.monotonic()
    first = end(begin(batch(spool, store.with_name("whole"), "--workers", "2")))[0]
    whole_s, count = float(str(first["elapsed_s"])), 0
    for _ in range(kills):
        child = begin(batch(spool, store, "--workers", "2"))
        try:
            child.wait(chance.uniform(0.0, 1.5 * whole_s / 4))
            child.communicate()
        except subprocess.TimeoutExpired:
            kill(child)
            count += 1
    end(begin(batch(spool, store, "--workers", "2")))
    return judged(f"batch killed {count} times", str(store), boards, begun_s)


def kill_workers(spool: Path, store: Path, boards: int, kills: int) -> bool:
    """Kill a worker that has begun work, again and again; each session may lose one.

    When all is solved before enough were killed, the store is judged and put aside, and the
    work is done anew in another.
    """
    chance, begun_s = random.Random(2), time.monotonic()
    count = nights = 0
    held = True
    while count < kills and nights < kills:
        nights += 1
        before = count
        child = begin(batch(spool, store, "--workers", "2", "--retry", "quarantined"))
        while child.poll() is None and count < kills:
            workers = [pid for pid in below(child.pid) if _is_worker(pid)]
            if workers:
                time.sleep(chance.uniform(0.0, 0.8))
                try:
                    os.kill(chance.choice(workers), signal.SIGKILL)
                    count += 1
                except ProcessLookupError:
                    continue
            time.sleep(0.3)
        end(child)
        for _ in range(3):
            end(begin(batch(spool, store, "--workers", "2", "--retry", "quarantined")))
        what = f"worker killed {count - before} times, {count} in all"
        held &= judged(what, str(store), boards, begun_s)
        store.rename(store.with_name(f"{store.name}-{nights}"))
    return held and count >= kills


def _is_worker(pid: int) -> bool:
    """Return whether a process is a fork of the server: it has used the processor by itself."""
    try:
        command = Path(f"/proc/{pid}/cmdline").read_bytes()
        threads = len(list(Path(f"/proc/{pid}/task").iterdir()))
    except OSError:
        return False
    parent_is_server = b"forkserver" in _command_of_parent(pid)
    return b"forkserver" in command and parent_is_server and threads >= 1


def _command_of_parent(pid: int) -> bytes:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return Path(f"/proc/{fields[1]}/cmdline").read_bytes()
    except OSError:
        return b""


def kill_scheduler(spool: Path, store: Path, boards: int, _kills: int) -> bool:
    """Kill scheduler and workers while they hold work."""
    begun_s = time.monotonic()
    with cluster(2) as (address, process):
        child = begin(batch(spool, store, "--scheduler", address))
        journal = store / "journal"
        while child.poll() is None and not any(p.stat().st_size for p in journal.glob("*.jsonl")):
            time.sleep(0.02)
        for pid in [*below(process.pid), process.pid]:
            os.kill(pid, signal.SIGKILL)
        end(child)
    end(begin(batch(spool, store, "--workers", "2")))
    return judged("scheduler killed", str(store), boards, begun_s)


def two_at_once(spool: Path, store: Path, boards: int, _kills: int) -> bool:
    """Run two batches on one store at the same time."""
    begun_s = time.monotonic()
    both = [begin(batch(spool, store, "--workers", "1")) for _ in range(2)]
    for child in both:
        end(child)
    return judged("two batches at once", str(store), boards, begun_s)


def bucket_errs(spool: Path, _store: Path, boards: int, kills: int) -> bool:
    """Run nights on an object store that refuses 5 % of all requests, some of them killed."""
    chance, begun_s = random.Random(3), time.monotonic()
    store = f"s3://{BUCKET}/store"
    with served(errors=0.05) as environment, tempfile.TemporaryDirectory() as folder:
        environment["XDG_CACHE_HOME"] = folder
        os.environ.update(environment)
        nights = killed = 0
        for number in range(kills // 4):
            child = begin([GYRORIG, *_words(spool, store)])
            nights += 1
            try:
                # the first of them while there is work to do
                child.wait(60.0 if number % 2 else chance.uniform(1.0, 6.0))
                child.communicate()
            except subprocess.TimeoutExpired:
                kill(child)
                killed += 1
        for _ in range(8):
            summary = end(begin([GYRORIG, *_words(spool, store)]))[0]
            nights += 1
            if summary and summary["put_off"] == 0 and not summary.get("others"):
                break
            time.sleep(5.0)
        for _ in range(8):
            try:
                what = f"a bucket that refuses 5 %, {nights} nights, {killed} killed"
                return judged(what, store, boards, begun_s)
            except Exception as fault:  # a listing that was refused is asked again
                say(f"again: {fault}")
    return False


def _words(spool: Path, store: str) -> list[str]:
    return ["batch", "--spool", str(spool), "--store", store, "--json", "--workers", "2"]


FAULTS: dict[str, Callable[[Path, Path, int, int], bool]] = {
    "batch": kill_batch,
    "workers": kill_workers,
    "scheduler": kill_scheduler,
    "two": two_at_once,
    "bucket": bucket_errs,
}


def main() -> int:
    """Run what is asked for; the exit code."""
    parser = argparse.ArgumentParser(description="nights on which everything dies")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "bench-fleet")
    parser.add_argument("--boards", type=int, default=12)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--only", default=",".join(FAULTS))
    asked = parser.parse_args()
    adopt()
    made = asked.work / "quick"
    command = [sys.executable, str(MAKE), "--out", str(made), "--boards", str(asked.boards)]
    subprocess.run([*command, "--nights", "1", "--at-once", "1"], check=True, capture_output=True)
    for number in range(FOREIGN):
        (made / "spool" / f"foreign{number}.mcap").write_bytes(b"foreign %d" % number)
    say("| what died | sessions | rows | versions | rows written twice | faults | s | |")
    say("|---|---|---|---|---|---|---|---|")
    held = True
    for name in asked.only.split(","):
        with tempfile.TemporaryDirectory() as folder:
            held &= FAULTS[name](made / "spool", Path(folder) / "store", asked.boards, asked.kills)
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
