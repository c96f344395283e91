# ruff: noqa: T201
"""What the check of a twin states if the rig has an effect that is outside the catalogue.

    python tests/bench/bench_twin_outside.py RESULTS.jsonl [--sessions 30] [--until 06:00]

Each session draws an effect of 3 to 10 times its minimal detectable size. One recording gives the
twin, and another recording of the same rig, with other noise, is checked. The command must list a
difference, or must have stated before that a part of the residual has no known cause. The file of
results has one line per session; a second call goes on after the last one.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.bench_twin_check import read_rows
from tests.hidden.truth.draws import draw_session, make_requests
from tests.hidden.truth.session import record

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.twin_check.check_wording import difference_text, differences, is_different
from gyrorig_solver.twin_check.twin_folder_check import check_twin_folder

BIN = Path(sys.executable).parent
FIRST_SEED, SECOND_SESSION = 12_970_000, 500_000
UNEXPLAINED = "has no known cause"
ACCEPTED = (0, 4)  # exit status of `gyrorig twin`: the twin is written


def check_session(seed: int, draws: int) -> dict[str, Any] | None:
    """Return what the check of one rig states; None if the draw has no effect."""
    session = draw_session(seed, "outside")
    if session is None or not session.items:
        return None
    rig = replace(
        session.rig, hide=make_requests(session.items) if session.extra_effects is None else ()
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fitted = folder / "fitted.mcap"
        first = record(rig, fitted, None, session.extra_effects)
        other = replace(rig, seed=rig.seed + SECOND_SESSION)
        record(other, folder / "new.mcap", first.rig.truth, session.extra_effects)
        words = [BIN / "gyrorig", "twin", fitted, "--out", folder / "twin"]
        written = subprocess.run(list(map(str, words)), check=False, capture_output=True, text=True)
        row: dict[str, Any] = {"seed": seed, "effect": session.items[0].name}
        row["times"] = session.items[0].wanted_times
        if written.returncode not in ACCEPTED:
            return {**row, "refused": written.stderr.strip()}
        row["unexplained"] = UNEXPLAINED in written.stdout + written.stderr
        check = check_twin_folder(folder / "twin", [read_recording(folder / "new.mcap")], draws)
        row["causes"] = [cause.cause for cause in check.twin.causes]
        after = check.boards[0].after
        row["different"] = is_different(after)
        row["differences"] = [difference_text(comparison) for comparison in differences(after)]
        row["density_p_value"] = after.density_p_value
    return row


def report(rows: list[dict[str, Any]]) -> bool:
    """Print the sessions; return whether each of them was reported in one way or the other."""
    print("| effect | times | causes of the twin | unexplained part | differences, largest |")
    print("|---|---|---|---|---|")
    silent = []
    for row in sorted(rows, key=lambda row: str(row["effect"])):
        if "refused" in row:
            print(f"| {row['effect']} | {row['times']:.1f} | refused: {row['refused']} | | |")
            continue
        largest = row["differences"][0] if row["differences"] else ""
        named = ", ".join(row["causes"]) or "none"
        stated = "stated" if row["unexplained"] else ""
        cells = [row["effect"], f"{row['times']:.1f}", named, stated]
        print(f"| {' | '.join(cells)} | {len(row['differences'])}: {largest} |")
        if not row["different"] and not row["unexplained"]:
            silent.append(row)
    checked = [row for row in rows if "refused" not in row]
    print(
        f"{len(rows)} sessions: {sum(row['different'] for row in checked)} with a difference, "
        f"{sum(row['unexplained'] for row in checked)} with an unexplained part, "
        f"{len(rows) - len(checked)} refused, {len(silent)} with neither"
    )
    return not silent


def main() -> int:
    """Check sessions until the time; exit with 1 if one of them has no statement."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path)
    parser.add_argument("--until", help="local time HH:MM after which no session begins")
    parser.add_argument("--sessions", type=int, default=30)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--draws", type=int, default=20)
    options = parser.parse_args()
    rows = read_rows(options.results)
    finished = {row["seed"] for row in rows}
    for seed in range(options.first_seed, options.first_seed + options.sessions):
        if seed in finished:
            continue
        if options.until and f"{datetime.now():%H:%M}" >= options.until:
            break
        row = check_session(seed, options.draws)
        if row is None:
            continue
        rows.append(row)
        with options.results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        print(f"{seed} {row['effect']}: {len(row.get('differences', []))} differences", flush=True)
    return 0 if rows and report(rows) else 1


if __name__ == "__main__":
    sys.exit(main())
