"""Measure the nightly batch: throughput, overhead, memory, growth, and a comparison with a peer.

The emulator makes the recordings once (tests/bench/fleet/make.py), and the bench keeps them in
--work. Other programs on the computer increase the elapsed times. The bench therefore compares
CPU times, and prints the elapsed times with them.

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

from tests.bench.fleet_growth import measure_growth, write_fleet_files
from tests.bench.fleet_machine import CommandCost, measure_command, measure_cpu_s
from tests.bench.synthetic_fleet import FleetPlan, write_fleet

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.calibration import CalibrationStore
from gyrorig_solver.fleet.store import StoreIndex
from gyrorig_solver.fleet.store.store_queries import VersionFilter, newest_versions

BIN = Path(sys.executable).parent
GYRORIG = str(BIN / "gyrorig")
MAKE_SCRIPT = Path(__file__).parent / "fleet" / "make.py"
PEER_SCRIPT = Path(__file__).parent / "fleet_peer.py"
KINDS = {
    "75 s at 800 Hz": ("fast", ["--program", "planned-75", "--odr", "800"]),
    "300 s at 100 Hz": ("slow", ["--program", "planned-300", "--odr", "100"]),
}
SIZES = (100, 1_000, 10_000)
MILLION_BOARDS, MILLION_NIGHTS = 100_000, 10
CLUSTER_SCRIPT = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    workers = int(sys.argv[1])
    with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


def print_line(text: str) -> None:
    """Print a line at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def make_spools(work: Path, boards: int) -> dict[str, Path]:
    """Return the spools of both kinds of recordings, and make them if they do not exist."""
    spools: dict[str, Path] = {}
    for kind, (name, arguments) in KINDS.items():
        out = work / f"{name}-{boards}"  # another number of boards needs another fleet
        command = [sys.executable, str(MAKE_SCRIPT), "--out", str(out), "--boards", str(boards)]
        command += ["--nights", "1", "--at-once", "1", *arguments]
        subprocess.run(command, check=True, capture_output=True)
        spools[kind] = out / "spool"
    return spools


@contextmanager
def start_cluster(workers: int) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """Start a scheduler with workers on this computer, and yield its address and process."""
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "cluster.py"
        script.write_text(CLUSTER_SCRIPT)
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
            process.communicate()  # it ends at the end of its input


def batch_command(spool: Path, store: Path, *more: str) -> list[str]:
    """Return the command line of a batch."""
    return [GYRORIG, "batch", "--spool", str(spool), "--store", str(store), "--json", *more]


def run_on_pool(spool: Path, workers: int) -> CommandCost:
    """Run a batch on a worker pool of this computer."""
    with tempfile.TemporaryDirectory() as folder:
        return measure_command(batch_command(spool, Path(folder) / "s", "--workers", str(workers)))


def run_on_dask(spool: Path, workers: int) -> CommandCost:
    """Run a batch on a scheduler; the cost includes its start and end."""
    script = (
        "import json, subprocess, sys, time; from pathlib import Path\n"
        "from tests.bench.bench_fleet import batch_command, start_cluster\n"
        "with start_cluster(int(sys.argv[3])) as (address, _):\n"
        "    start_s = time.monotonic()\n"
        "    spool, store = Path(sys.argv[1]), Path(sys.argv[2])\n"
        "    subprocess.run(batch_command(spool, store, '--scheduler', address))\n"
        "    print(json.dumps({'wall_s': time.monotonic() - start_s}))\n"
    )
    root = str(Path(__file__).resolve().parents[2])
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", script, str(spool), f"{folder}/s", str(workers)]
        return measure_command(command, {**os.environ, "PYTHONPATH": root})


def run_shards(spool: Path, workers: int) -> CommandCost:
    """Run several batches at once, each with one worker and a separate shard."""
    with tempfile.TemporaryDirectory() as folder:
        commands = [
            " ".join(
                batch_command(
                    spool, Path(folder) / "s", "--workers", "1", "--shard", f"{k}/{workers}"
                )
            )
            for k in range(1, workers + 1)
        ]
        return measure_command(["sh", "-c", " & ".join(commands) + " & wait"])


ENGINES: dict[str, Callable[[Path, int], CommandCost]] = {
    "pool": run_on_pool,
    "dask": run_on_dask,
    "shards": run_shards,
}


def measure_throughput(work: Path, boards: int) -> None:
    """Print the boards per core and hour for each engine."""
    print_line(
        "\n| recordings | engine | workers | elapsed, s | CPU, s per board "
        "| boards per core and hour | memory of the largest worker, MB |"
    )
    print_line("|---|---|---|---|---|---|---|")
    for kind, spool in make_spools(work, boards).items():
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
                board_cpu_s = result.cpu_s / boards
                print_line(
                    f"| {kind} | {engine} | {workers} | {result.wall_s:.1f} | {board_cpu_s:.2f} "
                    f"| {3600 / board_cpu_s:.0f} | {result.worker_mb:.0f} |"
                )


def measure_overhead(tasks: int) -> None:
    """Print the cost of a job that the batch rejects at once."""
    print_line(f"\nThe overhead is measured with {tasks} invalid recordings and with one:\n")
    print_line("| engine | CPU, ms per job | elapsed, ms per job | batch of one job, s of CPU |")
    print_line("|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        few, many = Path(folder) / "few", Path(folder) / "many"
        for spool, count in ((few, 1), (many, tasks)):
            spool.mkdir()
            for number in range(count):
                (spool / f"{number}.mcap").write_bytes(b"foreign %d" % number)
        for engine in ("pool", "dask"):
            single, several = (ENGINES[engine](spool, 1) for spool in (few, many))
            cpu_ms = (several.cpu_s - single.cpu_s) / (tasks - 1) * 1e3
            wall_ms = (several.wall_s - single.wall_s) / (tasks - 1) * 1e3
            print_line(f"| {engine} | {cpu_ms:.1f} | {wall_ms:.1f} | {single.cpu_s:.1f} |")


def measure_sizes(work: Path, boards: int) -> None:
    """Print the time to list, to query and to resume for several numbers of boards."""
    document, report = solve_one_board(work, boards)
    print_line(
        f"\nA calibration has {len(document) / 1e3:.1f} kB, "
        f"its report {len(report) / 1e3:.0f} kB.\n"
    )
    print_line(
        "| boards | list the spool, s | read all heads, s | night without new recordings, s "
        "| store ls, s | store verify, s | index, bytes per row |"
    )
    print_line("|---|---|---|---|---|---|---|")
    for size in SIZES:
        with tempfile.TemporaryDirectory(dir=work) as folder:
            spool, store = write_fleet_files(Path(folder), size, document, report)
            print_line(f"| {size} | {measure_growth(spool, store, size)} |")


def solve_one_board(work: Path, boards: int) -> tuple[str, bytes]:
    """Solve a recording of board B000000; return the calibration and its report."""
    spool = make_spools(work, boards)["75 s at 800 Hz"]
    folder = work / "one"
    if not folder.exists():
        folder.mkdir()
        shutil.copy(min(spool.glob("*.mcap")), folder)
        subprocess.run(batch_command(folder, work / "one-store"), check=True, capture_output=True)
    version = CalibrationStore(work / "one-store").versions(BoardId("B000000"))[0]
    report = version.path.with_suffix(".report.html").read_bytes()
    return version.path.read_text(encoding="utf-8"), report


def measure_index() -> None:
    """Print the time of queries in an index of a million rows."""
    with tempfile.TemporaryDirectory() as folder:
        store = Path(folder) / "store"
        write_fleet(store, FleetPlan(boards=MILLION_BOARDS, nights=MILLION_NIGHTS, measured=1.0))
        index = StoreIndex(store)
        (count,) = index.query("SELECT count(*) FROM rows")[0]
        size = sum(path.stat().st_size for path in (store / "index").glob("*.parquet"))
        print_line(
            f"\n{count} rows, {MILLION_BOARDS} boards: {size / 1e6:.0f} MB, "
            f"{size / count:.0f} bytes per row\n"
        )
        print_line("| query | elapsed, s | CPU, s |")
        print_line("|---|---|---|")
        queries: dict[str, Callable[[], object]] = {
            "all versions of one board": lambda: index.query(
                "SELECT version, scale_z FROM rows WHERE board = 'B012345' ORDER BY version"
            ),
            "the newest versions of 1000 boards": lambda: newest_versions(
                store, VersionFilter(), 1000
            ),
            "mean and standard deviation of a parameter by sensor": lambda: index.query(
                "SELECT sensor, avg(scale_z), stddev(scale_z) FROM rows GROUP BY sensor"
            ),
            "the keys of all finished jobs (at each start of a batch)": index.finished_keys,
        }
        for name, run_query in queries.items():
            start_s, start_cpu_s = time.monotonic(), time.process_time()
            run_query()
            wall_s, cpu_s = time.monotonic() - start_s, time.process_time() - start_cpu_s
            print_line(f"| {name} | {wall_s:.2f} | {cpu_s:.2f} |")


def measure_peer(work: Path, boards: int) -> None:
    """Print the CPU time of the public reader with SciPy, without the start of processes."""
    print_line(
        "\n| recordings | public reader and SciPy, s of CPU per board | reading alone "
        "| gyrorig | reading alone | ratio |"
    )
    print_line("|---|---|---|---|---|---|")
    for kind, spool in make_spools(work, boards).items():
        peer_cost = measure_command([sys.executable, str(PEER_SCRIPT), str(spool)])
        if peer_cost.code:
            raise SystemExit(peer_cost.err)
        peer_rows = [json.loads(line) for line in peer_cost.out.splitlines()]
        peer_s, peer_reading_s = (
            sum(row[key] for row in peer_rows) / boards for key in ("cpu_s", "read_s")
        )
        with tempfile.TemporaryDirectory() as folder:
            store = Path(folder) / "s"
            subprocess.run(
                batch_command(spool, store, "--workers", "1"), check=True, capture_output=True
            )
            ((solver_s,),) = StoreIndex(store).query("SELECT avg(seconds) FROM rows")
        paths = sorted(spool.glob("*.mcap"))
        reading_s = sum(measure_cpu_s(partial(read_recording, path)) for path in paths) / boards
        print_line(
            f"| {kind} | {peer_s:.2f} | {peer_reading_s:.2f} | {solver_s:.2f} | {reading_s:.3f} "
            f"| {peer_s / solver_s:.1f} |"
        )


def main() -> int:
    """Run the selected measurements; return the exit status."""
    parts = ("throughput", "overhead", "growth", "index", "peer")
    parser = argparse.ArgumentParser(description="measure the nightly batch")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "bench-fleet")
    parser.add_argument("--boards", type=int, default=8, help="number of recordings of each kind")
    parser.add_argument("--tasks", type=int, default=400, help="jobs for the overhead")
    parser.add_argument(
        "--only", default=",".join(parts), help="one or more of: " + ",".join(parts)
    )
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    only = options.only.split(",")
    if "throughput" in only:
        measure_throughput(options.work, options.boards)
    if "overhead" in only:
        measure_overhead(options.tasks)
    if "growth" in only:
        make_spools(options.work, options.boards)
        measure_sizes(options.work, options.boards)
    if "index" in only:
        measure_index()
    if "peer" in only:
        measure_peer(options.work, options.boards)
    return 0


if __name__ == "__main__":
    sys.exit(main())
