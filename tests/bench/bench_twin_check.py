# ruff: noqa: T201
"""P-values of the check of a twin if nothing is hidden: are they uniform?

    python tests/bench/bench_twin_check.py RESULTS.jsonl --until 06:00 [--sessions 200] [--draws 20]

Each session has a new rig. The twin comes from one program and is checked on a recording of another
one. Only the twin is simulated. The file of results has one line per session; a second call goes on
after the last line, and reports on all of them.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.twin_check.recording_check import check_board
from gyrorig_solver.twin_check.simulation import Simulator, run_draws

ROOT = Path(__file__).resolve().parents[2]
SHORT = Path(__file__).with_name("short_program.yaml")
BIN = Path(sys.executable).parent
LOWEST_P = 0.01  # of the test that p-values are uniform
LIMIT = 0.01  # false alarms of one session
MAX_RANKS = 40  # different p-values of a statistic of rare events with 20 draws
RANKED_P = (0.05, 0.1, 0.2)


def program_file(name: str) -> Path:
    """Return a program of `config/programs` by its name, or the file of that path."""
    path = Path(name)
    return path if path.suffix == ".yaml" else ROOT / "config" / "programs" / f"{name}.yaml"


def record(folder: Path, seed: int, program: str, session_seed: int) -> Path:
    """Record the rig of a seed; return the recording."""
    words: list[str | Path] = [BIN / "gyrorigd", "record", "--simulated-time", "--json"]
    words += ["--config", ROOT / "config" / "rig.yaml", "--seed", str(seed)]
    words += ["--program", program_file(program)]
    words += ["--session-seed", str(session_seed), "--out", folder]
    recorded = subprocess.run(list(map(str, words)), check=True, capture_output=True, text=True)
    return Path(json.loads(recorded.stdout)["recording"])


def check_rig(folder: Path, seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Return the p-values of one rig, and the densities of which one comes."""
    fitted = record(folder, seed, options.fitted, 2 * seed)
    measured = read_recording(record(folder, seed, options.program, 2 * seed + 1))
    words = [BIN / "gyrorig", "-q", "twin", fitted, "--out", folder / "twin"]
    subprocess.run(list(map(str, words)), check=True, capture_output=True)
    simulator = Simulator("after", folder / "twin" / "twin.yaml")
    draws = range(options.draws + 1)
    (runs,) = run_draws([(simulator, draws)], measured, folder, lambda: None)
    board = check_board(measured, measured.board_ids[0], True, runs[:6], (), runs)
    after = board.after
    return {
        "seed": seed,
        "draws": options.draws,
        "density": after.density_p_value,
        "nats_per_s": after.nats_per_s,
        "ceiling_nats_per_s": after.ceiling_nats_per_s,
        "draws_nats_per_s": after.draws_nats_per_s.tolist(),
        "statistics": {c.family.key: c.p_value for c in after.comparisons},
        "z": {c.family.key: c.z.tolist() for c in after.comparisons},
    }


def report(rows: list[dict[str, Any]]) -> bool:
    """Print the tests of all p-values; return whether the density passes."""
    by_key: dict[str, list[float]] = {"density": [row["density"] for row in rows]}
    for row in rows:
        for key, p_value in row["statistics"].items():
            by_key.setdefault(key, []).append(p_value)
    constant = [key for key, values in by_key.items() if min(values) == max(values) == 1.0]
    for key in constant:
        print(f"{key}: equal in all draws and in the measurement, p = 1, in each session")
        del by_key[key]
    for key in [key for key, values in by_key.items() if len(set(values)) <= MAX_RANKS]:
        ranked = np.array(by_key.pop(key))
        shares = ", ".join(f"{np.mean(ranked <= p):.3f} at most {p}" for p in RANKED_P)
        print(f"{key}: only {len(set(ranked))} different p-values, so not uniform; {shares}")
    print(f"{len(rows)} sessions of {rows[0]['draws']} draws")
    print("statistic          n  mean p  KS distance  KS p     smallest p")
    for key, values in by_key.items():
        test = stats.kstest(values, "uniform")
        print(
            f"{key:16s} {len(values):3d}  {np.mean(values):6.3f}  {test.statistic:11.3f}  "
            f"{test.pvalue:.2g}".ljust(58)
            + f"{min(values):.2g}"
        )
    pooled = [p for key, values in by_key.items() if key != "density" for p in values]
    test = stats.kstest(pooled, "uniform")
    print(f"all statistics together: n {len(pooled)}, KS {test.statistic:.3f}, p {test.pvalue:.2g}")
    alarms = sum(
        min([row["density"], *row["statistics"].values()]) < LIMIT / (len(row["statistics"]) + 1)
        for row in rows
    )
    print(f"sessions with a difference: {alarms} of {len(rows)} (expected {LIMIT:.0%})")
    z = [
        (row["nats_per_s"] - np.mean(row["draws_nats_per_s"]))
        / np.std(row["draws_nats_per_s"], ddof=1)
        for row in rows
    ]
    print(f"density in units of the draws' scatter: mean {np.mean(z):+.2f}, std {np.std(z):.2f}")
    return bool(stats.kstest(by_key["density"], "uniform").pvalue > LOWEST_P)


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return the sessions of earlier calls."""
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text("utf-8").splitlines() if line.strip()]


def main() -> int:
    """Check sessions until the time; exit with 1 if the density's p-values are not uniform."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path)
    parser.add_argument("--until", help="local time HH:MM after which no session begins")
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=5001)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--fitted", default="survey-40", help="program of the twin's recording")
    parser.add_argument("--program", default=str(SHORT), help="program of the checked recording")
    options = parser.parse_args()
    rows = read_rows(options.results)
    seeds = range(options.first_seed, options.first_seed + options.sessions)
    finished_seeds = {row["seed"] for row in rows}
    for seed in (seed for seed in seeds if seed not in finished_seeds):
        if options.until and f"{datetime.now():%H:%M}" >= options.until:
            break
        with tempfile.TemporaryDirectory() as folder:
            row = check_rig(Path(folder), seed, options)
        rows.append(row)
        with options.results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        print(f"seed {seed}: density p {row['density']:.3f}", flush=True)
    return 0 if rows and report(rows) else 1


if __name__ == "__main__":
    sys.exit(main())
