"""Figures of the nightly batch: throughput, overhead, memory, growth, peers.

Recordings are made once, by the emulator (tests/bench/fleet/make.py), and kept in --work.
Times of a machine that does other things too are of little worth: the processor's seconds are
what is compared, and the time on the clock is given beside them.

Run: python tests/bench/bench_fleet.py [--work DIR] [--only throughput,overhead,growth,index,peer]
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.fleet_growth import costs, fill
from tests.bench.fleet_machine import CommandCost, measured, timed
from tests.bench.synthetic_fleet import FleetPlan, write_fleet

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.calibration import CalibrationStore
from gyrorig_solver.fleet.store import StoreIndex
from gyrorig_solver.fleet.store.store_queries import VersionFilter, newest_versions

BIN = Path(sys.executable).parent
GYRORIG = str(BIN / "gyrorig")
MAKE = Path(__file__).parent / "fleet" / "make.py"
PEER = Path(__file__).parent / "fleet_peer.py"
KINDS = {
    "75 s at 800 Hz": ("fast", ["--program", "planned-75", "--odr", "800"]),
    "300 s at 100 Hz": ("slow", ["--program", "planned-300", "--odr", "100"]),
}
SIZES = (100, 1_000, 10_000)
MILLION_BOARDS, MILLION_NIGHTS = 100_000, 10
CLUSTER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    workers = int(sys.argv[1])
    with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


def say(text: str) -> None:
    """Print what is known so far."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def spools(work: Path, boards: int) -> dict[str, Path]:
    """Return the spools of both kinds of recordings; made where they lack."""
    made: dict[str, Path] = {}
    for kind, (name, arguments) in KINDS.items():
        out = work / f"{name}-{boards}"  # another number is another fleet
        command = [sys.executable, str(MAKE), "--out", str(out), "--boards", str(boards)]
        command += ["--nights", "1", "--at-once", "1", *arguments]
        subprocess.run(command, check=True, capture_output=True)
        made[kind] = out / "spool"
    return made


@contextmanager
def cluster(workers: int) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """Give the address of a scheduler of this machine with so many workers."""
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "cluster.py"
        script.write_text(CLUSTER)
        process = subprocess.Popen(
            [sys.executable, str(script), str(workers)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=folder,
        )
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip(), process
        finally:
            process.communicate()  # its input's end ends it


def batch(spool: Path, store: Path, *more: str) -> list[str]:
    """Return the command of a batch."""
    return [GYRORIG, "batch", "--spool", str(spool), "--store", str(store), "--json", *more]


def by_pool(spool: Path, workers: int) -> CommandCost:
    """Run a batch on this machine's own processes."""
    with tempfile.TemporaryDirectory() as folder:
        return measured(batch(spool, Path(folder) / "s", "--workers", str(workers)))


def by_dask(spool: Path, workers: int) -> CommandCost:
    """Run a batch on a scheduler, whose start and end count too."""
    script = (
        "import subprocess, sys, json; from tests.bench.bench_fleet import batch, cluster; "
        "from pathlib import Path; import time\n"
        "with cluster(int(sys.argv[3])) as (address, _):\n"
        "    begun = time.monotonic()\n"
        "    subprocess.run(batch(Path(sys.argv[1]), Path(sys.argv[2]), '--scheduler', address))\n"
        "    print(json.dumps({'wall_s': time.monotonic() - begun}))\n"
    )
    root = str(Path(__file__).resolve().parents[2])
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", script, str(spool), f"{folder}/s", str(workers)]
        return measured(command, {**os.environ, "PYTHONPATH": root})


def by_shards(spool: Path, workers: int) -> CommandCost:
    """Run so many batches at once, each with one worker and its own shard."""
    with tempfile.TemporaryDirectory() as folder:
        commands = [
            " ".join(
                batch(spool, Path(folder) / "s", "--workers", "1", "--shard", f"{k}/{workers}")
            )
            for k in range(1, workers + 1)
        ]
        return measured(["sh", "-c", " & ".join(commands) + " & wait"])


ENGINES: dict[str, Callable[[Path, int], CommandCost]] = {
    "pool": by_pool,
    "dask": by_dask,
    "shards": by_shards,
}


def throughput(work: Path, boards: int) -> None:
    """Print boards a second and core."""
    say(
        "\n| recordings | engine | workers | on the clock, s | processor, s a board "
        "| boards a core and hour | largest worker, MB |"
    )
    say("|---|---|---|---|---|---|---|")
    for kind, spool in spools(work, boards).items():
        for engine, run in ENGINES.items():
            for workers in (1, 2):
                result = run(spool, workers)
                solved = sum(
                    json.loads(line)["ended"].get("ok", 0)
                    for line in result.out.splitlines()
                    if '"ended"' in line
                )
                if solved != boards:
                    raise SystemExit(f"{solved} of {boards} solved by {engine}: {result.err}")
                each_s = result.cpu_s / boards
                say(
                    f"| {kind} | {engine} | {workers} | {result.wall_s:.1f} | {each_s:.2f} "
                    f"| {3600 / each_s:.0f} | {result.worker_mb:.0f} |"
                )


def overhead(tasks: int) -> None:
    """Print what a piece of work costs that is refused at once."""
    say(f"\n{tasks} recordings that are none, against one:\n")
    say("| engine | processor, ms a piece | clock, ms a piece | a batch of one, processor s |")
    say("|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        few, many = Path(folder) / "few", Path(folder) / "many"
        for spool, count in ((few, 1), (many, tasks)):
            spool.mkdir()
            for number in range(count):
                (spool / f"{number}.mcap").write_bytes(b"foreign %d" % number)
        for engine in ("pool", "dask"):
            small, all_of = (ENGINES[engine](spool, 1) for spool in (few, many))
            cpu_ms = (all_of.cpu_s - small.cpu_s) / (tasks - 1) * 1e3
            wall_ms = (all_of.wall_s - small.wall_s) / (tasks - 1) * 1e3
            say(f"| {engine} | {cpu_ms:.1f} | {wall_ms:.1f} | {small.cpu_s:.1f} |")


def growth(work: Path, boards: int) -> None:
    """Print what listing, looking up and resuming cost with the number of boards."""
    document, report = one_document(work, boards)
    say(
        f"\nA calibration is {len(document) / 1e3:.1f} kB, its report {len(report) / 1e3:.0f} kB.\n"
    )
    say(
        "| boards | listing the spool, s | reading heads anew, s | a night with nothing new, s "
        "| store ls, s | store verify, s | index, bytes a row |"
    )
    say("|---|---|---|---|---|---|---|")
    for size in SIZES:
        with tempfile.TemporaryDirectory(dir=work) as folder:
            spool, store = fill(Path(folder), size, document, report)
            say(f"| {size} | {costs(spool, store, size)} |")


def one_document(work: Path, boards: int) -> tuple[str, bytes]:
    """Return a real calibration of board B000000 and its report."""
    spool = spools(work, boards)["75 s at 800 Hz"]
    folder = work / "one"
    if not folder.exists():
        folder.mkdir()
        shutil.copy(min(spool.glob("*.mcap")), folder)
        subprocess.run(batch(folder, work / "one-store"), check=True, capture_output=True)
    version = CalibrationStore(work / "one-store").versions(BoardId("B000000"))[0]
    report = version.path.with_suffix(".report.html").read_bytes()
    return version.path.read_text(encoding="utf-8"), report


def index_of_a_million() -> None:
    """Print how long questions to a million rows take."""
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "store"
        write_fleet(store, FleetPlan(boards=MILLION_BOARDS, nights=MILLION_NIGHTS, measured=1.0))
        index = StoreIndex(store)
        (count,) = index.query("SELECT count(*) FROM rows")[0]
        size = sum(path.stat().st_size for path in (store / "index").glob("*.parquet"))
        say(
            f"\n{count} rows, {MILLION_BOARDS} boards: {size / 1e6:.0f} MB, "
            f"{size / count:.0f} bytes a row\n"
        )
        say("| question | on the clock, s | processor, s |")
        say("|---|---|---|")
        questions: dict[str, Callable[[], object]] = {
            "all versions of one board": lambda: index.query(
                "SELECT version, scale_z FROM rows WHERE board = 'B012345' ORDER BY version"
            ),
            "the newest version of each board, 1000 of them": lambda: newest_versions(
                store, VersionFilter(), 1000
            ),
            "mean and scatter of a parameter by sensor": lambda: index.query(
                "SELECT sensor, avg(scale_z), stddev(scale_z) FROM rows GROUP BY sensor"
            ),
            "the keys of all work done (at each start of a batch)": index.finished_keys,
        }
        for name, ask in questions.items():
            begun, cpu = time.monotonic(), time.process_time()
            ask()
            say(f"| {name} | {time.monotonic() - begun:.2f} | {time.process_time() - cpu:.2f} |")


def peer(work: Path, boards: int) -> None:
    """Print what the stock reader with SciPy takes for the same recordings, starts left out."""
    say(
        "\n| recordings | stock reader and SciPy, processor s a board | of it reading "
        "| ours | of it reading | ratio |"
    )
    say("|---|---|---|---|---|---|")
    for kind, spool in spools(work, boards).items():
        theirs = measured([sys.executable, str(PEER), str(spool)])
        if theirs.code:
            raise SystemExit(theirs.err)
        peer_rows = [json.loads(line) for line in theirs.out.splitlines()]
        each, reading = (sum(row[key] for row in peer_rows) / boards for key in ("cpu_s", "read_s"))
        with tempfile.TemporaryDirectory() as folder:
            store = Path(folder) / "s"
            subprocess.run(batch(spool, store, "--workers", "1"), check=True, capture_output=True)
            ((mine,),) = StoreIndex(store).query("SELECT avg(seconds) FROM rows")
        paths = sorted(spool.glob("*.mcap"))
        reading_s = sum(timed(partial(read_recording, path)) for path in paths) / boards
        say(
            f"| {kind} | {each:.2f} | {reading:.2f} | {mine:.2f} | {reading_s:.3f} "
            f"| {each / mine:.1f} |"
        )


def main() -> int:
    """Run what is asked for; the exit code."""
    parts = ("throughput", "overhead", "growth", "index", "peer")
    parser = argparse.ArgumentParser(description="figures of the nightly batch")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "bench-fleet")
    parser.add_argument("--boards", type=int, default=8, help="recordings of each kind")
    parser.add_argument("--tasks", type=int, default=400, help="pieces for the overhead")
    parser.add_argument("--only", default=",".join(parts), help="some of: " + ",".join(parts))
    asked = parser.parse_args()
    asked.work.mkdir(parents=True, exist_ok=True)
    only = asked.only.split(",")
    if "throughput" in only:
        throughput(asked.work, asked.boards)
    if "overhead" in only:
        overhead(asked.tasks)
    if "growth" in only:
        spools(asked.work, asked.boards)
        growth(asked.work, asked.boards)
    if "index" in only:
        index_of_a_million()
    if "peer" in only:
        peer(asked.work, asked.boards)
    return 0


if __name__ == "__main__":
    sys.exit(main())
