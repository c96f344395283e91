"""Share of sole right names before and after one proposed second program.

Each session hides one cause in an emulated rig and records survey-40. Where the search states a set
of causes, the proposed program is recorded on the same rig with other noise, and both recordings
are explained together. A run goes on where it was stopped: each session is one line of the file.

Run: python tests/bench/bench_separation.py --out separation.jsonl [--sets 50] [--minutes 20]
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402 - the lines above make threads few and find the packages
from tests.hidden.truth.session import RigDraw, record  # noqa: E402
from tests.support.board_fits import explain_recordings  # noqa: E402

from gyrorig_daemon.emulator.emulator_settings import InjectionRequest  # noqa: E402
from gyrorig_protocol.recording.reader import read_recording  # noqa: E402
from gyrorig_solver.discover import FitExplanation  # noqa: E402
from gyrorig_solver.model.catalogue import catalogue  # noqa: E402
from gyrorig_solver.pipeline.next_experiment import next_experiment  # noqa: E402
from gyrorig_solver.plan import program_text  # noqa: E402

FIRST_SEED, SECOND_SESSION = 8_400_000, 500_000
PROGRAM = "survey-40"


@dataclass(frozen=True, slots=True)
class HiddenCause:
    """One cause with the sizes at which survey-40 often states a set."""

    cause: str
    place: str
    sizes: tuple[float, float]
    soak_k: float = 0.0


PAIRS: dict[str, tuple[HiddenCause, HiddenCause]] = {
    "bias_ramp, warm_up": (
        HiddenCause("bias_ramp", "", (8e-5, 1.6e-4)),
        HiddenCause("warm_up", "", (8e-3, 1.5e-2)),
    ),
    "scale_asymmetry, scale_quadratic": (
        HiddenCause("scale_asymmetry", "", (7e-4, 1.4e-3)),
        HiddenCause("scale_quadratic", "", (4e-4, 9e-4)),
    ),
    "step_resolution, tilt_sag": (
        HiddenCause("step_resolution", "tilt", (3e-3, 5e-3)),
        HiddenCause("tilt_sag", "tilt", (3.5e-3, 5e-3)),
    ),
    "scale_asymmetry, vibration_rectification": (
        HiddenCause("scale_asymmetry", "z", (4e-4, 7e-4)),
        HiddenCause("vibration_rectification", "x", (1.5e-4, 4e-4)),
    ),
    "scale_quadratic, vibration_rectification": (
        HiddenCause("scale_quadratic", "z", (2.5e-4, 5e-4)),
        HiddenCause("vibration_rectification", "z", (1.5e-4, 4e-4)),
    ),
    "motor_coupling, scale_asymmetry": (
        HiddenCause("motor_coupling", "", (4e-4, 9e-4)),
        HiddenCause("scale_asymmetry", "z", (3e-4, 6e-4)),
    ),
}


def draw_of(pair: str, number: int) -> tuple[RigDraw, HiddenCause]:
    """Return the rig of one session and what it hides."""
    index = list(PAIRS).index(pair)
    hidden = PAIRS[pair][number % 2]
    seed = FIRST_SEED + 10_000 * index + number
    low, high = np.log(hidden.sizes)
    size = float(np.exp(np.random.default_rng([seed, 60]).uniform(low, high)))
    request = InjectionRequest(hidden.cause, hidden.place, size)
    return RigDraw(seed, PROGRAM, hidden.soak_k, hide=(request,)), hidden


def judge_session(pair: str, number: int, max_second_s: float) -> dict[str, Any]:
    """Record and explain one session; where a set is stated, also the proposed program."""
    draw, hidden = draw_of(pair, number)
    row: dict[str, Any] = {"pair": pair, "number": number, "truth": hidden.cause}
    with tempfile.TemporaryDirectory() as folder:
        first = Path(folder) / "first.mcap"
        session = record(draw, first)
        recording = read_recording(first)
        board = recording.board_ids[0]
        explanation = explain_recordings([recording], board)
        row["before"] = stated_sets(explanation)
        begin_s = time.monotonic()
        proposed = next_experiment([recording], explanation, None, max_second_s)
        row["plan_s"] = round(time.monotonic() - begin_s, 2)
        if proposed is None:
            return row
        row["outlooks"] = [[*o.causes, round(o.nats, 2), o.probability] for o in proposed.outlooks]
        if proposed.program is None:
            return row
        row["second_s"] = round(proposed.duration_s, 1)
        program = Path(folder) / "next-program.yaml"
        program.write_text(program_text(proposed.program), encoding="utf-8")
        second = Path(folder) / "second.mcap"
        seed = draw.seed + SECOND_SESSION
        record(RigDraw(seed, str(program), hide=draw.hide), second, session.rig.truth)
        both = [recording, read_recording(second)]
        row["after"] = stated_sets(explain_recordings(both, board))
    return row


def stated_sets(explanation: FitExplanation) -> list[list[str]]:
    """Return the stated sets of causes, the most probable cause of each first."""
    return [list(cause.candidates) for cause in explanation.findings.causes]


def is_sole(sets: list[list[str]], truth: str) -> bool:
    """Return whether each stated name is the truth alone, or with what is equal to it."""
    same = {truth, *catalogue()[truth].equivalent_causes}
    return bool(sets) and all(truth in names and set(names) <= same for names in sets)


def is_wrong(sets: list[list[str]], truth: str) -> bool:
    """Return whether a stated set does not hold the truth."""
    return any(truth not in names for names in sets)


def summary_lines(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the table: one row for each cause of each pair, and one for all."""
    yield "| pair | truth | named | sole before | sets | program | sole after | wrong after |"
    yield "|---|---|---|---|---|---|---|---|"
    for pair, causes in PAIRS.items():
        for hidden in causes:
            judged = [r for r in rows if r["pair"] == pair and r["truth"] == hidden.cause]
            yield f"| {pair} | {hidden.cause} | {_counts_text(judged)} |"
    yield f"| all | | {_counts_text(rows)} |"


def _counts_text(rows: list[dict[str, Any]]) -> str:
    named = [row for row in rows if row["before"]]
    sole = [row for row in named if is_sole(row["before"], row["truth"])]
    sets = [row for row in named if row not in sole and not is_wrong(row["before"], row["truth"])]
    after = [row for row in sets if "after" in row]
    sole_after = sum(is_sole(row["after"], row["truth"]) for row in after)
    wrong_after = sum(is_wrong(row["after"], row["truth"]) for row in after)
    counts = (len(named), len(sole), len(sets), len(after), sole_after, wrong_after)
    return " | ".join(str(count) for count in counts)


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return the lines of a file; one that a stop cut off is left out."""
    rows = []
    for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        try:
            rows.append(json.loads(text))
        except json.JSONDecodeError:
            continue
    return rows


def run(out: Path, asked: argparse.Namespace) -> None:
    """Add sessions until each pair has so many sets, or the time is over."""
    rows = read_rows(out)
    pairs = [pair for pair in PAIRS if asked.pair in pair]
    stop_s = time.monotonic() + 60.0 * asked.minutes
    numbers = {pair: _new_numbers(pair, read_rows(out)) for pair in pairs}
    running: set[Future[dict[str, Any]]] = set()
    with ProcessPoolExecutor(asked.workers) as pool, out.open("a", encoding="utf-8") as file:
        while True:
            counts = {pair: sum(r["pair"] == pair and "after" in r for r in rows) for pair in pairs}
            missing = [pair for pair in pairs if counts[pair] < asked.sets]
            if not missing or time.monotonic() > stop_s:
                pending = list(running)
            else:
                while len(running) < asked.workers:
                    pair = min(missing, key=lambda name: counts[name])
                    counts[pair] += 1
                    future = pool.submit(judge_session, pair, next(numbers[pair]), asked.seconds)
                    running.add(future)
                pending = list(running)
            if not pending:
                return
            finished, running = wait(pending, return_when=FIRST_COMPLETED)
            for future in finished:
                rows.append(future.result())
                file.write(json.dumps(rows[-1]) + "\n")
                file.flush()


def _new_numbers(pair: str, rows: list[dict[str, Any]]) -> Iterator[int]:
    used = {row["number"] for row in rows if row["pair"] == pair}
    return (number for number in count() if number not in used)


def main() -> None:
    """Run sessions and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--out", type=Path, default=Path("separation.jsonl"))
    parser.add_argument("--sets", type=int, default=1, help="stated sets of each pair")
    parser.add_argument("--minutes", type=float, default=1e3)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=120.0, help="longest second program")
    parser.add_argument("--pair", default="", help="only pairs whose name contains this")
    asked = parser.parse_args()
    run(asked.out, asked)
    sys.stdout.write("\n".join(summary_lines(read_rows(asked.out))) + "\n")


if __name__ == "__main__":
    main()
