"""Whether calibrations by attitudes with bad stamps hold: a study of jitter and drift.

Simulated sessions (tests/support/simulated_attitudes.py) are solved as they are. For every kind
of stamp the table says how often the 95 % intervals of gain, bias and time offset hold the truth,
the rms and the largest error in standard deviations, and how many sessions were refused. With
--state, the study goes on where it stopped.

Run: python tests/bench/bench_reference_stamps.py [--runs N] [--state F] [--case WORDS] [--defects]
"""

import argparse
import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path

for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402 - after the number of threads
from tests.support.simulated_attitudes import (  # noqa: E402
    SimulatedAttitudes,
    StampSettings,
    simulate_attitudes,
)
from tests.support.simulated_samples import plain_samples  # noqa: E402

from gyrorig_protocol.errors import GyrorigError  # noqa: E402
from gyrorig_solver.data import FloatArray  # noqa: E402
from gyrorig_solver.estimate import fit_attitude  # noqa: E402
from gyrorig_solver.reference import read_attitude  # noqa: E402

JITTERS_MS = (0.0, 0.5, 1.0, 2.0, 5.0)
SKEWS_PPM = (0.0, 100.0)
HEADER = (
    "| stamps | runs | refused | gain and bias in 95 % | time offset in 95 % | rms error, sd "
    "| largest error, sd |\n| --- | --- | --- | --- | --- | --- | --- |"
)
WITHIN_95 = 1.96


@dataclass(frozen=True, slots=True)
class StudyCase:
    """One kind of stamps."""

    name: str
    settings: StampSettings
    camera_hz: float = 100.0


def study_cases() -> list[StudyCase]:
    """Return the cases of the jitter study."""
    cases = []
    for kind in ("arrival", "exponential", "device"):
        for jitter_ms in JITTERS_MS:
            for skew_ppm in SKEWS_PPM:
                if jitter_ms == 0.0 and kind != "device":
                    continue
                name = f"{kind}, {jitter_ms:g} ms, {skew_ppm:g} ppm"
                cases.append(StudyCase(name, StampSettings(1e-3 * jitter_ms, kind, skew_ppm)))
    return cases


def defect_cases() -> list[StudyCase]:
    """Return the cases of other defects of references."""
    jitter_s = 0.5e-3
    return [
        StudyCase("5 % dropped", StampSettings(jitter_s, drop_share=0.05)),
        StudyCase(
            "2 % dropped, exponential 2 ms", StampSettings(2e-3, "exponential", 0.0, 0.0, 0.02)
        ),
        StudyCase("2 % dropped, device 5 ms", StampSettings(5e-3, drop_share=0.02)),
        StudyCase("3 % repeated", StampSettings(jitter_s, repeat_share=0.03)),
        StudyCase("1 % outliers", StampSettings(jitter_s, outlier_share=0.01)),
        StudyCase("6 s lost, arrival 1 ms", StampSettings(1e-3, "arrival", lost_s=6.0)),
        StudyCase("markers swapped by 90 deg", StampSettings(jitter_s, swap=(0.0, 0.0, 1.57))),
        StudyCase("markers swapped by 4 deg", StampSettings(jitter_s, swap=(0.07, 0.0, 0.0))),
        StudyCase("clock steps by 10 ms", StampSettings(jitter_s, step_s=0.01)),
        StudyCase("500 ppm", StampSettings(0.0, skew_ppm=500.0)),
        StudyCase("frames truly irregular, 1 ms", StampSettings(irregular_s=1e-3)),
        StudyCase("300 Hz, arrival 2 ms", StampSettings(2e-3, "arrival"), 300.0),
        StudyCase("50 Hz, device 2 ms", StampSettings(2e-3), 50.0),
    ]


def errors_in_sd(session: SimulatedAttitudes) -> FloatArray:
    """Return the errors of gain, bias and time offset in standard deviations, (13,).

    Raises:
        GyrorigError: the session is refused.
    """
    reference = read_attitude(
        session.stamp_s, session.orientation_xyzw, np.full(session.stamp_s.size, np.nan)
    )
    fit = fit_attitude([(plain_samples(session.gyro_time_s, session.gyro_rad_s), reference)])
    bias_std = np.array([fit.std[f"bias.{axis}"] for axis in "xyz"])
    offset = (fit.time_offset_s - session.time_offset_s) / fit.std["time_offset"]
    return np.concatenate(
        [
            ((fit.gain - session.gain) / fit.gain_std).ravel(),
            (fit.bias_rad_s - session.bias_rad_s) / bias_std,
            [offset],
        ]
    )


def study_line(case: StudyCase, seeds: range, state: dict[str, list[float] | str]) -> str:
    """Run what the state lacks of a case, and return its line of the table."""
    runs = len(seeds)
    for seed in seeds:
        key = f"{case.name} #{seed}"
        if key not in state:
            session = simulate_attitudes(seed, case.settings, camera_hz=case.camera_hz)
            try:
                state[key] = errors_in_sd(session).tolist()
            except GyrorigError as fault:
                state[key] = str(fault)
    outcomes = [state[f"{case.name} #{seed}"] for seed in seeds]
    solved = [outcome for outcome in outcomes if not isinstance(outcome, str)]
    reasons = {outcome for outcome in outcomes if isinstance(outcome, str)}
    line = f"| {case.name} | {runs} | {runs - len(solved)} "
    if not solved:
        return f"{line}| refused: {min(reasons)} | | | |"
    errors = np.array(solved)
    inside = np.abs(errors) < WITHIN_95
    return (
        f"{line}| {100 * inside[:, :12].mean():.1f} % | {100 * inside[:, 12].mean():.1f} % "
        f"| {np.sqrt(np.mean(errors**2)):.2f} | {np.abs(errors).max():.1f} |"
    )


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--runs", type=int, default=50, help="sessions of each case")
    parser.add_argument("--first-seed", type=int, default=0, help="of the sessions of each case")
    parser.add_argument("--state", type=Path, help="keeps the results of each session")
    parser.add_argument("--case", default="", help="only cases whose name holds these words")
    parser.add_argument("--defects", action="store_true", help="other defects than jitter")
    given = parser.parse_args()
    state = {}
    if given.state is not None and given.state.exists():
        state = json.loads(given.state.read_text(encoding="utf-8"))
    seeds = range(given.first_seed, given.first_seed + given.runs)
    print(HEADER)  # noqa: T201
    for case in defect_cases() if given.defects else study_cases():
        if given.case in case.name:
            print(study_line(case, seeds, state), flush=True)  # noqa: T201
            if given.state is not None:
                given.state.write_text(json.dumps(state), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
