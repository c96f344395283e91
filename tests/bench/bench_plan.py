"""The total uncertainty that the planner predicts, and the one that a solve states.

A program is recorded on several emulated rigs without hidden causes. For each parameter the root
mean square of the stated totals over the rigs is divided by the predicted total.

Run: python tests/bench/bench_plan.py [--rigs N] [--program NAME]
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.bench.bench_uncertainty import ROOT, judge, record, show

from gyrorig_protocol.program import parse_program
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.calibration import find_profile
from gyrorig_solver.pipeline.board_data import load_board
from gyrorig_solver.pipeline.prepare_board import fit_base
from gyrorig_solver.plan import load_rig, predict_program, predict_total
from gyrorig_solver.plan.prediction import CALIBRATION_PARAMETERS
from gyrorig_solver.plan.total_prediction import PlanPrior
from gyrorig_solver.uncertainty import default_settings


def predicted_totals(name: str) -> np.ndarray:
    """Return the predicted total of each parameter, SI."""
    rig = load_rig(ROOT / "config" / "rig.yaml")
    profile = find_profile(rig.sensor_name)
    if profile is None:
        raise SystemExit(f"there is no profile of {rig.sensor_name}")
    sensor = rig.sensor(profile)
    text = (ROOT / "config" / "programs" / f"{name}.yaml").read_bytes()
    prediction = predict_program(parse_program(text, name), rig.unit, sensor)
    total = predict_total(prediction, sensor, rig.site, PlanPrior(default_settings()))
    return np.array([total.std[parameter] for parameter in CALIBRATION_PARAMETERS])


def stated_totals(name: str, seed: int) -> list[float]:
    """Return the total of each parameter that a solve of the base model states, SI."""
    with tempfile.TemporaryDirectory() as folder:
        path, _ = record(Path(folder), name, seed, [])
        recording = read_recording(path)
        fit = fit_base(load_board([recording], str(recording.board_ids[0])))
        totals: list[float] = judge(fit, np.zeros(len(CALIBRATION_PARAMETERS)))["total"]
    return totals


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--program", default="survey-40")
    given = parser.parse_args()
    stated = np.array(
        [stated_totals(given.program, given.seed + number) for number in range(given.rigs)]
    )
    ratio = np.sqrt(np.mean(stated**2, axis=0)) / predicted_totals(given.program)
    for name, value, row in zip(CALIBRATION_PARAMETERS, ratio, stated.T, strict=True):
        show(f"{name:<22} stated / predicted {value:.2f}   median stated {np.median(row):.3g}")


if __name__ == "__main__":
    main()
