"""Memory and time of check, solve, batch and import on hostile files, against their bounds.

    python tests/bench/bench_hostile.py [--files 200] [--state FILE] [--only FAMILY]

A command may use 400 MB and 20 times the size of its input, and 30 s of the processor and 30 s per
10 MB. It ends with a result or a refusal (exit status 0, 3, 4 or 5), never by a signal or as a
fault of the program. Each row is written to the state file, so that a run can be continued.
"""

# ruff: noqa: T201 - its output is its table
import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.support.hostile_files import IMPORT_FAMILIES, IMPORT_MAP, RECORDING_FAMILIES

SIZES = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000, 10_000_000)
LARGE_SIZES = (30_000_000, 100_000_000)
LARGE_FAMILIES = (
    *("landmarks", "nested_landmarks", "random_bytes", "zeros", "chunk_bomb"),
    *("long_table", "wide_table", "large_attachments"),
)
BATCH_SIZES = (30_000, 3_000_000)  # a batch starts many processes
ACCEPTED = (0, 3, 4, 5)  # done, refused, not identifiable, some refused
TIMEOUT_S = 900.0
START_CPU_S = 15.0  # of the interpreter and its libraries, on a busy machine


def bound_memory_bytes(size: int) -> int:
    """Return the memory that a command may use for an input."""
    return 400_000_000 + 20 * size


def bound_time_s(size: int) -> float:
    """Return the processor time that a command may use for an input."""
    return 30.0 + 30.0 * size / 10e6


def measure(command: list[str], folder: Path) -> dict[str, Any]:
    """Run a command; return exit status, largest resident memory, time and the last line."""
    started_s, largest_bytes = time.monotonic(), 0
    with (folder / "output.txt").open("w+b") as output:
        child = subprocess.Popen(
            command, cwd=folder, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
        )
        while True:
            largest_bytes = max(largest_bytes, largest_resident_bytes(child.pid))
            pid, status, usage = os.wait4(child.pid, os.WNOHANG)
            if pid:
                break
            if time.monotonic() - started_s > TIMEOUT_S:
                os.killpg(child.pid, 9)
            time.sleep(0.1)
        child.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        lines = output.read().decode(errors="replace").strip().splitlines() or [""]
    return {
        "exit": child.returncode,
        "memory": max(usage.ru_maxrss * 1024, largest_bytes),
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "wall_s": time.monotonic() - started_s,
        "said": lines[-1][:300],
    }


def largest_resident_bytes(session: int) -> int:
    """Return the peak of the largest process of a session; workers are not children of ours."""
    peaks = [0]
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if os.getsid(int(folder.name)) == session:
                text = (folder / "status").read_text()
                peaks += [int(words.split()[1]) * 1024 for words in text.splitlines()
                          if words.startswith("VmHWM")]  # fmt: skip
        except OSError:
            continue
    return max(peaks)


def commands(file: Path, folder: Path) -> dict[str, list[str]]:
    """Return the commands to run on a file, by name."""
    gyrorig = [sys.executable, "-m", "gyrorig_solver"]
    if file.suffix == ".mcap":
        store = str(folder / "store")
        batch = [*gyrorig, "batch", "--spool", str(file.parent), "--store", store]
        return {
            "check": [*gyrorig, "check", str(file)],
            "solve": [*gyrorig, "solve", str(file), "--extend", "none", "--out", f"{store}-solved"],
            "batch": [*batch, "--workers", "1", "--extend", "none"],
            "batch again": [*batch, "--workers", "1", "--extend", "none"],
        }
    words = ["--map", str(folder / "map.yaml")] if file.suffix != ".json" else []
    kind = [file.suffix[1:]] if words else []
    target = ["--board", "B-1", "-o", str(folder / "imported.mcap")]
    return {"import": [*gyrorig, "import", *kind, str(file), *words, *target]}


def examine(family: str, size: int) -> list[dict[str, Any]]:
    """Make one hostile file, and run the commands on it."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="hostile-") as made:
        folder, spool = Path(made), Path(made) / "spool"
        spool.mkdir()
        (folder / "map.yaml").write_text(IMPORT_MAP)
        if family in RECORDING_FAMILIES:
            file = RECORDING_FAMILIES[family](spool / "x.mcap", size)
        else:
            make, suffix = IMPORT_FAMILIES[family]
            file = make(spool / f"x{suffix}", size)
        real_size = file.stat().st_size
        for name, command in commands(file, folder).items():
            if name.startswith("batch") and size not in BATCH_SIZES:
                continue
            row = measure(command, folder)
            allowed_s = bound_time_s(real_size) + START_CPU_S
            row["good"] = (
                row["exit"] in ACCEPTED
                and row["memory"] <= bound_memory_bytes(real_size)
                and row["cpu_s"] <= allowed_s
            )
            rows.append({"family": family, "size": real_size, "wish": size, "command": name} | row)
    return rows


def plan(count: int) -> list[tuple[str, int]]:
    """Return the files to make: every family, small sizes first."""
    names = [*RECORDING_FAMILIES, *IMPORT_FAMILIES]
    files = [(name, size) for size in SIZES for name in names]
    files += [(name, size) for size in LARGE_SIZES for name in LARGE_FAMILIES]
    return files[:count] if count < len(files) else files


def table(rows: list[dict[str, Any]]) -> str:
    """Return the worst figures of each family."""
    by_family = defaultdict(list)
    for row in rows:
        by_family[row["family"]].append(row)
    lines = [
        "family | files | runs | largest file MB | peak MB | of bound | CPU s | of bound | exits"
    ]
    for family, members in sorted(by_family.items()):
        memory = max(members, key=lambda row: row["memory"] / bound_memory_bytes(row["size"]))
        slow = max(members, key=lambda row: row["cpu_s"] / bound_time_s(row["size"]))
        lines.append(
            f"{family} | {len({row['wish'] for row in members})} | {len(members)} | "
            f"{max(row['size'] for row in members) / 1e6:.2f} | {memory['memory'] / 1e6:.0f} | "
            f"{memory['memory'] / bound_memory_bytes(memory['size']):.2f} | {slow['cpu_s']:.1f} | "
            f"{slow['cpu_s'] / bound_time_s(slow['size']):.2f} | "
            f"{sorted({row['exit'] for row in members})}"
        )
    return "\n".join(lines)


def main() -> int:
    """Run the bench and print the table; exit status 1 if a bound is missed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--state", type=Path)
    parser.add_argument("--only")
    parser.add_argument("--max-size", type=int, default=10**9)
    options = parser.parse_args()
    finished_rows: list[dict[str, Any]] = []
    if options.state and options.state.exists():
        finished_rows = [json.loads(line) for line in options.state.read_text().splitlines()]
    finished = {(row["family"], row["wish"]) for row in finished_rows}
    for family, size in plan(options.files):
        is_wanted = options.only in (None, family) and size <= options.max_size
        if (family, size) in finished or not is_wanted:
            continue
        rows = examine(family, size)
        finished_rows += rows
        if options.state:
            with options.state.open("a") as file:
                file.writelines(json.dumps(row) + "\n" for row in rows)
        for row in rows:
            if not row["good"]:
                print("MISSED", json.dumps(row), flush=True)
    missed = [row for row in finished_rows if not row["good"]]
    print(table(finished_rows))
    files = {(row["family"], row["wish"]) for row in finished_rows}
    families = len({family for family, _ in files})
    counts = f"{len(files)} files of {families} families, {len(finished_rows)} runs"
    print(f"{counts}, {len(missed)} missed a bound")
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main())
