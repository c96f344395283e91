"""Sessions with something hidden in them, explained and scored: the long tier.

Cause and rig come from one seed; the answer's hash is printed before the finder sees the
recording, and the answer is read by the scorer only. Sizes are the emulated rig's own
draws, or given. Results are added to a file line by line, so that a run can go on where it
was stopped.

Run: python tests/hidden/sessions.py [--runs 100] [--first 1000] [--out FILE]
"""

import argparse
import contextlib
import hashlib
import io
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.stats import beta

from gyrorig_daemon.cli import run
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.discover.finder import explain
from gyrorig_solver.discover.result import Findings

ROOT = Path(__file__).resolve().parents[2]
CAUSES = (
    "acceleration_error", "axis_nonorthogonality", "backlash", "base_compliance",
    "base_speed_jump", "bias_ramp", "bias_step", "board_slip", "clock_skew", "clock_step",
    "dead_zone", "eccentricity@pan", "g_sensitivity", "low_pass_lag", "lost_steps",
    "motor_coupling", "ringing", "s_curve", "saturation", "scale_asymmetry", "scale_cubic",
    "scale_quadratic", "step_resolution@tilt", "supply_hum", "thermal_bias", "thermal_scale",
    "tilt_sag", "vibration_rectification", "warm_up", "worm_error",
)  # fmt: skip
NULLS, TWOS = 0.3, 0.15  # shares of sessions with nothing, and with two causes


def drawn(seed: int) -> tuple[str, ...]:
    """Return what a session hides."""
    rng = np.random.default_rng(seed)
    kind = rng.random()
    count = 0 if kind < NULLS else 2 if kind < NULLS + TWOS else 1
    return tuple(str(one) for one in rng.choice(CAUSES, count, replace=False))


def session(seed: int, hide: tuple[str, ...], program: str, folder: Path) -> Path:
    """Record one session; return the recording."""
    orders = [word for one in hide for word in ("--hide", one)]
    with contextlib.redirect_stdout(io.StringIO()):
        run(
            ["record", "--config", str(ROOT / "config" / "rig.yaml"), "--program",
             str(ROOT / "config" / "programs" / f"{program}.yaml"), "--out", str(folder),
             "--simulated-time", "--seed", str(seed),
             "--truth", str(folder / "truth.json"), *orders]
        )  # fmt: skip
    return next(folder.glob("*.mcap"))


def score(findings: Findings, truth: set[str]) -> dict[str, Any]:
    """Return what was right and what was not."""
    sets = [one.candidates for one in findings.causes]
    sole = {names[0] for names in sets if len(names) == 1}
    stated = {name for names in sets for name in names}
    return {
        "truth": sorted(truth),
        "stated": [list(names) for names in sets],
        "verdict": findings.verdict,
        "sole": len(sole & truth),
        "in_set": len(stated & truth),
        "wrong": sum(1 for names in sets if not truth & set(names)),
        "missed": len(truth - stated),
        "false_alarm": not truth and findings.verdict != "adequate",
        "nats": findings.gain.log_likelihood.value if findings.gain else 0.0,
        "seconds": findings.seconds,
    }


def limits(hits: int, many: int) -> str:
    """Return a share with its exact 95 % limits (Clopper and Pearson)."""
    if not many:
        return "none"
    low = float(beta.ppf(0.025, hits, many - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, many - hits)) if hits < many else 1.0
    return f"{hits} of {many} = {hits / many:.1%} ({low:.1%} to {high:.1%})"


def main() -> None:
    """Run the sessions that are not yet in the file, then sum up all that are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--program", default="full")
    parser.add_argument("--out", type=Path, default=Path("hidden-sessions.jsonl"))
    told = parser.parse_args()
    done: dict[int, dict[str, Any]] = {}
    if told.out.exists():
        done = {row["seed"]: row for row in map(json.loads, told.out.read_text().splitlines())}
    for seed in range(told.first, told.first + told.runs):
        if seed in done:
            continue
        hide = drawn(seed)
        sealed = hashlib.sha256(json.dumps([seed, *hide]).encode()).hexdigest()[:16]
        sys.stderr.write(f"{seed} sealed {sealed}\n")
        with tempfile.TemporaryDirectory() as folder:
            recording = read_recording(session(seed, hide, told.program, Path(folder)))
            findings = explain([recording], recording.board_ids[0]).findings
        truth = {one.partition("@")[0] for one in hide}
        done[seed] = {"seed": seed, "sealed": sealed, **score(findings, truth)}
        with told.out.open("a") as out:
            out.write(json.dumps(done[seed]) + "\n")
        sys.stderr.write(f"{seed} {truth or 'nothing'}: {done[seed]['stated']}\n")
    rows = list(done.values())
    nulls = [row for row in rows if not row["truth"]]
    hidden = sum(len(row["truth"]) for row in rows)
    sys.stdout.write(
        f"false alarms {limits(sum(row['false_alarm'] for row in nulls), len(nulls))}\n"
        f"right sole name {limits(sum(row['sole'] for row in rows), hidden)}\n"
        f"in the stated set {limits(sum(row['in_set'] for row in rows), hidden)}\n"
        f"wrong names {sum(row['wrong'] for row in rows)}, "
        f"missed {sum(row['missed'] for row in rows)}\n"
    )


if __name__ == "__main__":
    main()
