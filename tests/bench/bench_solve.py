"""What one board costs, from the recording to the YAML: 75 s at 800 Hz, step by step.

An emulated board on an emulated unit carries out the shipped 75 s program in simulated
time; its recording is then solved over and over in this one process, as a batch does.
Processor time of each step is the median of many turns; ratios are to eq. 7 of the paper
(one pseudo-inverse over the same samples) and to imucal's Ferraris of as many samples,
taken in the same turns.

Run: python tests/bench/bench_solve.py [--turns N] [--out FILE]
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.peers import turns

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.calibration.calibration_document import calibration_as_yaml
from gyrorig_solver.data.clocks.lower_envelope import _cached_envelope
from gyrorig_solver.estimate import UNIT_REMEDIES, fit_motion
from gyrorig_solver.pipeline.board_data import load_board
from gyrorig_solver.pipeline.solve_board import build_fit_document
from gyrorig_solver.reference import read_pan_tilt_reference

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "config" / "programs" / "paper.yaml"  # 75 s
GOAL_BOARDS_S, AIM_BOARDS_S = 10.0, 20.0


def record(folder: Path) -> Path:
    """Record 75 s of a board at 800 Hz behind 110 Hz, on an emulated unit."""
    text = (ROOT / "config" / "rig.yaml").read_text(encoding="utf-8")
    text = text.replace("odr_hz: 100", "odr_hz: 800").replace(
        "bandwidth_hz: 25.0", "bandwidth_hz: 110.0"
    )
    rig = folder / "rig.yaml"
    rig.write_text(text, encoding="utf-8")
    command = [str(Path(sys.executable).with_name("gyrorigd")), "record", "--simulated-time"]
    command += [
        "--config",
        str(rig),
        "--program",
        str(PROGRAM),
        "--seed",
        "3",
        "--out",
        str(folder),
    ]
    subprocess.run(command, check=True, capture_output=True)
    return next(folder.glob("*.mcap"))


def eq_7(rate: np.ndarray) -> np.ndarray:
    """The paper's eq. 7: a pseudo-inverse of all samples times all samples."""
    return np.asarray(np.linalg.pinv(rate) @ rate)


def turn(path: Path, spent: dict[str, list[float]]) -> None:
    """Solve once, booking the processor time of every step."""
    _cached_envelope.cache_clear()
    at = time.process_time()

    def book(step: str) -> None:
        nonlocal at
        now = time.process_time()
        spent.setdefault(step, []).append(now - at)
        at = now

    recording = read_recording(path)
    board = recording.board_ids[0]
    book("read")
    data = load_board([recording], board)
    (samples,) = data.samples
    book("clocks and samples")
    reference = read_pan_tilt_reference(recording, samples.origin_ns)
    book("reference")
    fit = fit_motion(samples, reference, UNIT_REMEDIES, reference.warnings)
    book("solve")
    calibration_as_yaml(build_fit_document(fit, data))
    book("write")


def main() -> int:
    """Measure and print; 1 where the goal is missed."""
    parser = argparse.ArgumentParser(description="processor time of one board")
    parser.add_argument("--turns", type=int, default=25)
    parser.add_argument("--out", type=Path, help="write the figures there")
    asked = parser.parse_args()
    spent: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = record(Path(folder))
        recording = read_recording(path)
        rate = load_board([recording], recording.board_ids[0]).samples[0].rate_rad_s
        ready = turns.imucal_installed()
        peer = turns.Imucal(turns.session(0, 800.0, 110.0)).compute if ready else None
        turn(path, {})
        for _ in range(asked.turns):
            turn(path, spent)
            at = time.process_time()
            eq_7(rate)
            spent.setdefault("eq. 7", []).append(time.process_time() - at)
            if peer is not None:
                at = time.process_time()
                peer()
                spent.setdefault("imucal", []).append(time.process_time() - at)
        samples = int(rate.shape[0])
    figures = judged(spent, samples)
    if asked.out:
        asked.out.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    print(shown(figures))  # noqa: T201
    return int(figures["boards_s"] < GOAL_BOARDS_S)


def judged(spent: dict[str, list[float]], samples: int) -> dict[str, Any]:
    """Return medians, the sum of the steps, and ratios."""
    ms = {step: statistics.median(values) * 1e3 for step, values in spent.items()}
    peers = {name: ms.pop(name) for name in ("eq. 7", "imucal") if name in ms}
    total = sum(ms.values())
    return {
        "samples": samples,
        "ms": ms,
        "total_ms": total,
        "boards_s": 1e3 / total,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "peers_ms": peers,
        "after_reading_to": {name: (total - ms["read"]) / value for name, value in peers.items()},
        "solve_to": {name: ms["solve"] / value for name, value in peers.items()},
    }


def shown(figures: dict[str, Any]) -> str:
    """The figures as lines."""
    lines = [f"{figures['samples']} samples, processor time of one core, median"]
    lines += [f"{step:<20}{value:8.1f} ms" for step, value in figures["ms"].items()]
    lines.append(f"{'together':<20}{figures['total_ms']:8.1f} ms")
    lines.append(
        f"boards a second and core: {figures['boards_s']:.1f} "
        f"(goal {GOAL_BOARDS_S:.0f}, aim {AIM_BOARDS_S:.0f}); peak {figures['peak_mb']:.0f} MB"
    )
    for name, value in figures["peers_ms"].items():
        lines.append(
            f"{name}: {value:.2f} ms; all after reading is {figures['after_reading_to'][name]:.0f} "
            f"times that, the solve alone {figures['solve_to'][name]:.0f} times"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
