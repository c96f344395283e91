# ruff: noqa: T201
"""Log predictive density of a new recording: default simulation, twin, and the truth's own one.

    python tests/bench/bench_twin_gain.py RESULTS.jsonl [--until 06:00] [--several]

Each session hides one cause at three times its minimal detectable size: the seeds, places and sizes
are those of `tests/hidden/fast_tier.json`. With `--several`, 30 sessions follow that hide two to
four of these causes, each with its size there. One recording of the rig gives the twin. Another
program is then recorded on the same rig with other noise, and predicted by four simulations: the
default one, the twin without its causes, the twin, and the truth itself with other noise.

    recovered       = (twin - default) / (truth - default)
    cause recovered = (twin - twin without causes) / (truth - twin without causes)

The second share has no part of the calibration. It is stated if its denominator is at least
`MIN_NATS`. The file of results has one line per session; a second call goes on after the last one.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.twin_check.recording_check import BoardCheck, check_board
from gyrorig_solver.twin_check.simulation import Simulator, run_draws
from gyrorig_solver.twin_check.twin_folder_check import calibrated_rig_text, default_rig_text

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
CASES = ROOT / "tests" / "hidden" / "fast_tier.json"
RIG = ROOT / "config" / "rig.yaml"
PROGRAM = "survey-40"  # of the sessions with several causes
MIN_NATS = 10.0  # smaller differences are the scatter of the draws
MEDIAN_GOAL, NAMED_GOAL = 0.95, 0.80
INSUFFICIENT = (
    4  # exit status of `gyrorig twin`: the twin is written, and a value is not observable
)
SEVERAL, SEVERAL_SEED, FEWEST, MOST = 30, 7000, 2, 4
# They change what the samples are; no size of theirs is a multiple of a detectable one.
CATEGORIES = ("axis_swap", "sign_flip", "wrong_full_scale")


def programs(name: str) -> Path:
    """Return a program of `config/programs`, or the file of that path."""
    path = Path(name)
    return path if path.suffix == ".yaml" else ROOT / "config" / "programs" / f"{name}.yaml"


def rig_words(case: dict[str, Any]) -> tuple[str, ...]:
    """Return the options of `gyrorigd record` that make the rig of a case."""
    words = ["--seed", str(case["seed"]), "--soak", str(case["soak_k"])]
    for hidden in case.get("hidden", [case]):
        place = f"@{hidden['place']}" if hidden["place"] else ""
        words += ["--hide", f"{hidden['cause']}{place}:{hidden['size']}"]
    return tuple(words)


def draw_several(cases: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the sessions with two to four causes of the cases; a function of the cases alone."""
    short = [c for c in cases if c["program"] == PROGRAM and c["cause"] not in CATEGORIES]
    for seed in range(SEVERAL_SEED, SEVERAL_SEED + SEVERAL):
        rng = np.random.default_rng(seed)
        count = int(rng.integers(FEWEST, MOST + 1))
        hidden = [short[k] for k in rng.choice(len(short), count, replace=False)]
        soak_k = max(case["soak_k"] for case in hidden)
        cause = "+".join(sorted(case["cause"] for case in hidden))
        yield {
            "seed": seed, "program": PROGRAM, "soak_k": soak_k, "cause": cause, "hidden": hidden
        }  # fmt: skip


def record(folder: Path, case: dict[str, Any], program: str, session_seed: int) -> Path:
    """Record a case; return the recording."""
    words: list[str | Path] = [BIN / "gyrorigd", "record", "--simulated-time", "--json"]
    words += ["--config", RIG, "--program", programs(program), "--out", folder]
    words += ["--session-seed", str(session_seed), *rig_words(case)]
    recorded = subprocess.run(list(map(str, words)), check=True, capture_output=True, text=True)
    return Path(json.loads(recorded.stdout)["recording"])


def write_simulators(folder: Path) -> Iterator[Simulator]:
    """Yield the default simulation and the twin without causes, beside the twin."""
    path = folder / "twin.yaml"
    text = path.read_bytes()
    default = folder / "default.yaml"
    default.write_text(default_rig_text(text, path), encoding="utf-8")
    yield Simulator("default", default, is_twin=False)
    if yaml.safe_load(text)["twin"]["causes"]:
        plain = folder / "without-causes.yaml"
        plain.write_text(calibrated_rig_text(text, path), encoding="utf-8")
        yield Simulator("without-causes", plain)


def measure_case(case: dict[str, Any], options: argparse.Namespace) -> dict[str, Any]:
    """Return the densities of one case, in nats per second."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fitted = record(folder, case, case["program"], 2 * case["seed"])
        words = [BIN / "gyrorig", "-q", "twin", fitted, "--out", folder / "twin"]
        written = subprocess.run(list(map(str, words)), check=False, capture_output=True)
        if written.returncode not in (0, INSUFFICIENT):
            raise SystemExit(written.stderr.decode("utf-8", "replace"))
        measured = read_recording(record(folder, case, options.program, 2 * case["seed"] + 1))
        twin = yaml.safe_load((folder / "twin" / "twin.yaml").read_text("utf-8"))["twin"]
        truth = Simulator("truth", RIG, is_twin=False, arguments=rig_words(case))
        after = Simulator("twin", folder / "twin" / "twin.yaml")
        simulators = [*write_simulators(folder / "twin"), after, truth]
        draws = range(options.draws + 1)
        default, *plain, runs, truth_runs = run_draws(
            [(simulator, draws) for simulator in simulators], measured, folder, lambda: None
        )
        board = measured.board_ids[0]
        # The same comparison twice: the middle place takes any simulation.
        by_truth = check_board(measured, board, True, default, truth_runs, runs)
        without = check_board(measured, board, True, default, plain[0], runs) if plain else None
    return row_of(case, [cause["cause"] for cause in twin["causes"]], by_truth, without)


def row_of(
    case: dict[str, Any], named: list[str], by_truth: BoardCheck, without: BoardCheck | None
) -> dict[str, Any]:
    """Return the line of a case."""
    truth = by_truth.without_causes
    assert truth is not None
    plain = None if without is None else without.without_causes
    return {
        "cause": case["cause"],
        "seed": case["seed"],
        "named": named,
        "seconds": by_truth.session.duration_s,
        "default": by_truth.before.nats_per_s,
        "plain": None if plain is None else plain.nats_per_s,
        "twin": by_truth.after.nats_per_s,
        "truth": truth.nats_per_s,
        "ceiling": by_truth.after.ceiling_nats_per_s,
    }


def share(row: dict[str, Any], begin: str) -> float:
    """Return the share of the distance from a simulation to the truth that the twin recovers."""
    possible = row["truth"] - row[begin] if row[begin] is not None else 0.0
    if possible * row["seconds"] < MIN_NATS:
        return float("nan")
    return float((row["twin"] - row[begin]) / possible)


def is_named_right(row: dict[str, Any]) -> bool:
    """Return whether the twin has exactly the causes that are hidden."""
    return set(row["cause"].split("+")) == set(row["named"])


def report(rows: list[dict[str, Any]]) -> bool:
    """Print the table; return whether both goals are met."""
    print(
        "| cause | named | default | without causes | twin | truth | recovered | cause recovered |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for row in sorted(rows, key=lambda row: str(row["cause"])):
        named = ", ".join(row["named"]) or "none"
        plain = "" if row["plain"] is None else f"{row['plain']:.1f}"
        cells = [f"{row['default']:.1f}", plain, f"{row['twin']:.1f}", f"{row['truth']:.1f}"]
        shares = [f"{share(row, begin):.2%}" for begin in ("default", "plain")]
        print(f"| {' | '.join([row['cause'], named, *cells, *shares])} |")
    recovered = np.array([share(row, "default") for row in rows])
    is_named = np.array([is_named_right(row) for row in rows])
    lowest = float(np.nanmin(recovered[is_named])) if is_named.any() else float("nan")
    cause_shares = np.array([share(row, "plain") for row in rows if is_named_right(row)])
    print(
        f"{len(rows)} sessions: median of recovered {np.nanmedian(recovered):.2%}, "
        f"lowest of the {is_named.sum()} named {lowest:.2%}"
    )
    if np.isfinite(cause_shares).any():
        print(
            f"cause recovered: median {np.nanmedian(cause_shares):.1%}, lowest "
            f"{np.nanmin(cause_shares):.1%} of {np.isfinite(cause_shares).sum()}"
        )
    return bool(np.nanmedian(recovered) >= MEDIAN_GOAL and not lowest < NAMED_GOAL)


def main() -> int:
    """Measure cases until the time; exit with 1 if a goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path)
    parser.add_argument("--until", help="local time HH:MM after which no session begins")
    parser.add_argument("--cause", action="append", default=[])
    parser.add_argument("--several", action="store_true", help="also two to four causes at once")
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--program", default="quick", help="program of the new recording")
    options = parser.parse_args()
    cases = [case for case in json.loads(CASES.read_text("utf-8")) if case["kind"] == "one"]
    if options.several:
        cases += list(draw_several(cases))
    text = options.results.read_text("utf-8") if options.results.exists() else ""
    rows = [json.loads(line) for line in text.splitlines() if line.strip()]
    finished = {row["seed"] for row in rows}
    for case in cases:
        if case["seed"] in finished or (options.cause and case["cause"] not in options.cause):
            continue
        if options.until and f"{datetime.now():%H:%M}" >= options.until:
            break
        row = measure_case(case, options)
        rows.append(row)
        with options.results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        print(f"{row['cause']}: named {row['named']}, {share(row, 'default'):.2%}", flush=True)
    return 0 if rows and report(rows) else 1


if __name__ == "__main__":
    sys.exit(main())
