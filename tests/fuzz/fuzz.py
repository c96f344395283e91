"""Fuzz every input for untrusted bytes: `make fuzz SECONDS=180`.

Each target runs in a separate process, at nice 10 and with limited memory, for the given
processor time. On a busy machine that takes much longer, and a guided run needs about a dozen
seconds to import the instrumented packages. With atheris (the extra `fuzz`) inputs are guided by
coverage, without it they are random; the table shows which. An input that causes a failure is kept
in the output folder, and the exit status is 1. Fix the fault, then put the input into
tests/fuzz/found/TARGET/.
"""

# ruff: noqa: T201 - a program that prints a table
import argparse
import importlib
import importlib.util
import json
import os
import random
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

TIMEOUT_FACTOR = 30.0  # limit of the real time, in processor times
MEMORY_BYTES = 4 << 30  # of address space; a decompression bomb causes a MemoryError
PRODUCT = ("gyrorig_protocol", "gyrorig_daemon", "gyrorig_solver")


def main() -> int:
    """Run the requested targets, print a table, return 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--seconds", type=float, default=180.0, help="of processor time, for each target"
    )
    parser.add_argument("--out", type=Path, default=Path("fuzz"))
    parser.add_argument("--target", action="append", help="only these")
    parser.add_argument("--one", help=argparse.SUPPRESS)  # in the process of one target
    parser.add_argument("--chance", action="store_true", help="without atheris")
    options = parser.parse_args()
    guided = importlib.util.find_spec("atheris") is not None and not options.chance
    if options.one:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
        run_one(options.one, options.seconds, options.out, guided)
        return 0
    if not guided:
        print(
            "no atheris, random inputs only (pip install gyrorig[fuzz])",
            file=sys.stderr,
        )
    options.out.mkdir(parents=True, exist_ok=True)
    rows = [row(name, options, guided) for name in options.target or names()]
    (options.out / "fuzz.json").write_text(json.dumps(rows, indent=1) + "\n")
    print(f"\n{sum(r['inputs'] for r in rows)} inputs, {sum(r['broken'] for r in rows)} broken")
    return int(any(row["broken"] for row in rows))


def names() -> list[str]:
    """Return the names of all targets without importing the packages to be instrumented."""
    command = "from tests.fuzz.all_targets import TARGETS; print(*TARGETS)"
    ended = subprocess.run(
        [sys.executable, "-c", command],
        cwd=Path(__file__).resolve().parents[2],
        capture_output=True,
        text=True,
        check=True,
    )
    return ended.stdout.split()


def row(name: str, options: argparse.Namespace, guided: bool) -> dict[str, Any]:
    """Run one target in a separate process and return its results."""
    command = [sys.executable, __file__, "--one", name, "--seconds", str(options.seconds)]
    command += ["--out", str(options.out), *(["--chance"] if not guided else [])]
    log = options.out / f"{name}.log"
    begun, spent_s = time.monotonic(), _spent_s()
    with log.open("w") as file:
        ended = subprocess.run(
            command,
            stdout=file,
            stderr=subprocess.STDOUT,
            check=False,
            preexec_fn=lambda: os.nice(10),
        )
    text = log.read_text(errors="replace")
    inputs = re.findall(r"(?:executed_units:|Done) +(\d+)", text)
    figures = {
        "target": name,
        "inputs": int(inputs[-1]) if inputs else 0,
        "seconds": round(time.monotonic() - begun, 1),
        "processor_s": round(_spent_s() - spent_s, 1),  # with its imports
        "guided": guided,
        "broken": int(ended.returncode != 0),
    }
    print(f"{name:16}{figures['inputs']:>12} inputs {figures['processor_s']:>7} s  "
          f"{'BROKEN: ' + str(log) if ended.returncode else 'ok'}", flush=True)  # fmt: skip
    return figures


def _spent_s() -> float:
    """Return the processor time of all finished targets."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def run_one(name: str, seconds: float, out: Path, guided: bool) -> None:
    """Fuzz one target in this process."""
    if guided:
        _guided(name, seconds, out)
        return
    from tests.fuzz.all_targets import TARGETS, crash_inputs  # noqa: PLC0415
    from tests.fuzz.mutate import mutate  # noqa: PLC0415

    target = TARGETS[name]
    seeds = [*target.seeds(), *crash_inputs(name)]
    chance, tried, end = random.Random(name), 0, time.process_time() + seconds
    data = b""
    try:
        while time.process_time() < end:
            data = mutate(chance, seeds, target.max_bytes)
            target.run(data)
            tried += 1
    except BaseException:
        (out / f"broken-{name}").write_bytes(data)
        raise
    finally:
        print(f"Done {tried} runs")


def _guided(name: str, seconds: float, out: Path) -> None:
    atheris: Any = importlib.import_module("atheris")  # an optional extra

    with atheris.instrument_imports(include=list(PRODUCT)):
        from tests.fuzz.all_targets import TARGETS, crash_inputs  # noqa: PLC0415
    target = TARGETS[name]
    corpus = out / "corpus" / name  # grows from run to run
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate([*target.seeds(), *crash_inputs(name)]):
        (corpus / f"seed-{number}").write_bytes(seed[: target.max_bytes])
    arguments = [
        sys.argv[0], str(corpus), f"-max_total_time={max(1, round(TIMEOUT_FACTOR * seconds))}",
        f"-max_len={target.max_bytes}", "-print_final_stats=1", "-timeout=30", "-rss_limit_mb=0",
        f"-artifact_prefix={out}/broken-{name}-", "-verbosity=1",
    ]  # fmt: skip
    end_s = time.process_time() + seconds

    def run(data: bytes) -> None:
        target.run(data)
        if time.process_time() > end_s:
            os.kill(os.getpid(), signal.SIGUSR1)  # libFuzzer exits with status 0

    atheris.Setup(arguments, run)
    atheris.Fuzz()


if __name__ == "__main__":
    sys.exit(main())
