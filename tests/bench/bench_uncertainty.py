"""How often the error of a calibration is within twice its total standard uncertainty.

Each emulated rig hides one or more causes, drawn from the table of prior sizes: a cause with the
probability that it is present, its size from a normal distribution. The search for causes runs as
in `gyrorig solve --extend auto`; the total uncertainty is of the fit at which it ends, and of the
base fit. A ridge estimate, in which all causes are fitted with their priors, is stated beside them.

Run: python tests/bench/bench_uncertainty.py [--rigs N] [--causes N] [--base-only] [--out FILE]
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from tests.support.board_fits import explain_recordings

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.check.true_values import _true_values
from gyrorig_solver.discover import CALIBRATION_PARAMETERS
from gyrorig_solver.discover.calibration_changes import CalibrationValues
from gyrorig_solver.estimate import ConvergedFit, NuisanceProjector
from gyrorig_solver.pipeline.board_data import load_board
from gyrorig_solver.pipeline.prepare_board import fit_base
from gyrorig_solver.uncertainty import assess_uncertainty, default_settings

ROOT = Path(__file__).resolve().parents[2]
# Cause to the places at which the emulator can hide it, in the unit of the solver's cause.
PLACES = {
    "axis_nonorthogonality": ("",), "backlash": ("@pan", "@tilt"), "base_compliance": ("@pan",),
    "base_speed_jump": ("@pan", "@tilt"), "acceleration_error": ("@pan", "@tilt"),
    "eccentricity": ("@pan",), "worm_error": ("@pan", "@tilt"),
    "step_resolution": ("@pan", "@tilt"), "tilt_sag": ("",), "tilt_zero": ("",),
    "ringing": ("@pan", "@tilt"), "s_curve": ("@pan", "@tilt"),
    "bias_ramp": ("@x", "@y", "@z"), "bias_step": ("@x", "@y", "@z"),
    "warm_up": ("@x", "@y", "@z"), "thermal_bias": ("@x", "@y", "@z"),
    "thermal_scale": ("@x", "@y", "@z"), "g_sensitivity": ("@x", "@y", "@z"),
    "motor_coupling": ("@x", "@y", "@z"), "vibration_rectification": ("@x", "@y", "@z"),
    "scale_asymmetry": ("@x", "@y", "@z"), "scale_quadratic": ("@x", "@y", "@z"),
    "scale_cubic": ("@x", "@y", "@z"), "dead_zone": ("@x", "@y", "@z"),
    "low_pass_lag": ("",), "board_slip": ("",), "clock_skew": ("",), "clock_step": ("",),
}  # fmt: skip
GROUPS = ("scale", "nonorthogonality", "misalignment", "bias", "time_offset")


def draw_causes(generator: np.random.Generator, count: int) -> list[str]:
    """Return hidden causes as `gyrorigd record --hide` takes them."""
    sizes = default_settings().prior_sizes
    names = [name for name in PLACES if sizes[name].size > 0.0]
    weights = np.array([sizes[name].probability for name in names])
    chosen = generator.choice(names, count, replace=False, p=weights / weights.sum())
    hidden = []
    for name in map(str, chosen):
        place = str(generator.choice(PLACES[name]))
        size = max(abs(generator.standard_normal()), 0.01) * sizes[name].size
        hidden.append(f"{name}{place}:{size:.6g}")
    return hidden


def record(folder: Path, program: str, seed: int, hide: list[str]) -> tuple[Path, dict[str, Any]]:
    """Record a program on an emulated rig that hides causes; return the file and the truth."""
    command = [str(Path(sys.executable).with_name("gyrorigd")), "record", "--simulated-time"]
    command += ["--config", str(ROOT / "config" / "rig.yaml"), "--seed", str(seed)]
    command += ["--program", str(ROOT / "config" / "programs" / f"{program}.yaml")]
    command += [word for cause in hide for word in ("--hide", cause)]
    command += ["--truth", str(folder / "truth.json"), "--out", str(folder)]
    subprocess.run(command, check=True, capture_output=True)
    return next(folder.glob("*.mcap")), json.loads((folder / "truth.json").read_text())


def judge(solution: ConvergedFit, truth: np.ndarray) -> dict[str, Any]:
    """Return errors and uncertainties of all parameters of a fit."""
    calibration = CalibrationValues.of(solution)
    projector = NuisanceProjector.at_fit(solution)
    begin_s = time.process_time()
    budget = assess_uncertainty(solution, projector=projector)
    seconds = time.process_time() - begin_s
    error = calibration.values - truth
    posterior = np.sqrt(np.clip(np.diag(budget.covariance), 0.0, None))
    return {
        "error": error.tolist(),
        "type_a": calibration.std.tolist(),
        "total": np.hypot(calibration.std, budget.std).tolist(),
        "ridge_error": (error - budget.expected_error).tolist(),
        "ridge_std": np.hypot(calibration.std, posterior).tolist(),
        "seconds": seconds,
    }


def measure(program: str, seed: int, causes: int, base_only: bool) -> dict[str, Any]:
    """Record one rig, solve it and compare it with the truth."""
    hide = draw_causes(np.random.default_rng(seed), causes)
    with tempfile.TemporaryDirectory() as name:
        path, truth = record(Path(name), program, seed, hide)
        recording = read_recording(path)
        board = str(recording.board_ids[0])
        values = _true_values(truth["boards"][board])
        if base_only:
            base = extended = fit_base(load_board([recording], board))
            named = []
        else:
            explanation = explain_recordings([recording], board)
            base, extended = explanation.solution_base, explanation.solution_extended
            named = [cause.cause for cause in explanation.findings.causes]
    true_values = np.concatenate([np.ravel(values[group]) for group in GROUPS])
    return {
        "seed": seed,
        "hidden": hide,
        "named": named,
        "base": judge(base, true_values),
        "extended": judge(extended, true_values),
    }


def coverage(rigs: list[dict[str, Any]], fit: str, error: str, std: str) -> np.ndarray:
    """Return the share of errors within two standard uncertainties, of each parameter."""
    errors = np.array([rig[fit][error] for rig in rigs])
    stds = np.array([rig[fit][std] for rig in rigs])
    known = np.isfinite(stds)
    inside = (np.abs(errors) <= 2.0 * stds) & known
    return np.asarray(inside.sum(axis=0) / np.maximum(known.sum(axis=0), 1))


COLUMNS = {
    "base A": ("base", "error", "type_a"),
    "base total": ("base", "error", "total"),
    "base ridge": ("base", "ridge_error", "ridge_std"),
    "auto A": ("extended", "error", "type_a"),
    "auto total": ("extended", "error", "total"),
    "auto ridge": ("extended", "ridge_error", "ridge_std"),
}


def table(rigs: list[dict[str, Any]]) -> str:
    """Return the shares by parameter, and the rms errors of the stated and the ridge values."""
    shares = {name: coverage(rigs, *keys) for name, keys in COLUMNS.items()}
    lines = ["parameter             " + "".join(f"{name:>12}" for name in shares)]
    for k, parameter in enumerate(CALIBRATION_PARAMETERS):
        lines.append(f"{parameter:<22}" + "".join(f"{s[k]:12.2f}" for s in shares.values()))
    lines.append(f"{'all':<22}" + "".join(f"{s.mean():12.3f}" for s in shares.values()))
    for fit in ("base", "extended"):
        rms = [
            np.sqrt(np.mean(np.square([rig[fit][key] for rig in rigs]), axis=0))
            for key in ("error", "ridge_error")
        ]
        ratio = ", ".join(f"{value:.2f}" for value in rms[1] / rms[0])
        lines.append(f"{fit}: rms error of the ridge estimate over the stated one's: {ratio}")
    seconds = np.median([rig["extended"]["seconds"] for rig in rigs])
    return "\n".join([*lines, f"{seconds:.2f} s of processor time for one budget"])


def line(rig: dict[str, Any]) -> str:
    """Return what a rig hides, what the search named, and the worst parameter."""
    ratio = np.abs(rig["extended"]["error"]) / np.array(rig["extended"]["total"])
    worst = int(np.nanargmax(ratio))
    return (
        f"{rig['seed']} {', '.join(rig['hidden'])} | named {', '.join(rig['named']) or '-'} | "
        f"worst {CALIBRATION_PARAMETERS[worst]} {ratio[worst]:.1f}"
    )


def show(text: str) -> None:
    """Print at once, so that a long run can be followed."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=40)
    parser.add_argument("--seed", type=int, default=9000)
    parser.add_argument("--program", default="survey-130")
    parser.add_argument("--causes", type=int, default=1)
    parser.add_argument("--base-only", action="store_true", help="fit without a search for causes")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    rigs = []
    for seed in range(given.seed, given.seed + given.rigs):
        rigs.append(measure(given.program, seed, given.causes, given.base_only))
        show(line(rigs[-1]))
    show(table(rigs))
    if given.out:
        given.out.write_text(json.dumps(rigs))


if __name__ == "__main__":
    main()
