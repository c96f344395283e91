# ruff: noqa: T201
"""Processor time of `gyrorig twin` and `gyrorig explain`, and the twin's deviations from the truth.

    python tests/bench/bench_twin.py --rigs 6 [--hide CAUSE]... [--program survey-40]

Each rig is recorded in simulated time. The twin should take at most twice as long as explain.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import yaml
from tests.support.twin_truth import compare_twin

from gyrorig_protocol.twin import parse_twin

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
COMMAND_TIME_S = 5e-3  # of config/rig.yaml
MAX_TIME_RATIO = 2.0
FARTHEST_SIGMA = 4.0


def run_timed(*words: str | Path) -> float:
    """Run a command of this project; return its processor time in s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [str(BIN / str(words[0])), *map(str, words[1:])]
    subprocess.run(command, check=False, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure_rig(folder: Path, seed: int, program: str, hide: list[str]) -> tuple[float, float, int]:
    """Record one rig; return both times and the number of values far from the truth."""
    causes = [word for cause in hide for word in ("--hide", cause)]
    words: list[str | Path] = ["gyrorigd", "record", "--simulated-time", "--seed", str(seed)]
    words += ["--out", folder, "--truth", folder / "truth.yaml"]
    words += ["--config", ROOT / "config" / "rig.yaml"]
    words += ["--program", ROOT / "config" / "programs" / f"{program}.yaml", *causes]
    run_timed(*words)
    recording = next(folder.glob("*.mcap"))
    explain_s = run_timed("gyrorig", "explain", recording, "--out", folder / "findings")
    twin_s = run_timed("gyrorig", "twin", recording, "--out", folder)
    twin = parse_twin((folder / "twin.yaml").read_bytes(), "twin.yaml")
    truth = yaml.safe_load((folder / "truth.yaml").read_text("utf-8"))
    deviations = list(compare_twin(twin, truth, COMMAND_TIME_S))
    far = [d for d in deviations if abs(d.sigma) > FARTHEST_SIGMA]
    largest = max(abs(d.sigma) for d in deviations)
    causes_text = ", ".join(cause.cause for cause in twin.causes) or "no cause"
    print(
        f"seed {seed}: explain {explain_s:.1f} s, twin {twin_s:.1f} s; {causes_text}; "
        f"{len(deviations)} values, the farthest {largest:.1f} standard deviations off"
    )
    for deviation in far:
        print(f"  {deviation.name}: {deviation.value:.6g}, truth {deviation.truth:.6g}")
    return explain_s, twin_s, len(far)


def main() -> int:
    """Measure all rigs; exit with 1 if the twin takes too long."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=6)
    parser.add_argument("--first-seed", type=int, default=11)
    parser.add_argument("--program", default="survey-40")
    parser.add_argument("--hide", action="append", default=[])
    options = parser.parse_args()
    rows = []
    for seed in range(options.first_seed, options.first_seed + options.rigs):
        with tempfile.TemporaryDirectory() as folder:
            rows.append(measure_rig(Path(folder), seed, options.program, options.hide))
    explain_s, twin_s, far = np.array(rows).T
    ratio = float(np.sum(twin_s) / np.sum(explain_s))
    print(f"twin / explain {ratio:.2f} (at most {MAX_TIME_RATIO}); {int(far.sum())} values far off")
    return int(ratio > MAX_TIME_RATIO)


if __name__ == "__main__":
    sys.exit(main())
