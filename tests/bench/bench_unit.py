"""How the stored posterior of a unit changes the boards that are solved after each other on it.

Each emulated rig has axes that lean by an angle drawn from the table of prior sizes, or by the
angle given, and one more persistent cause drawn from it. Worm error and eccentricity are left
out: the emulator draws their phase for each recording, so that it is not one unit. Several boards
are recorded and solved one after another into one store, as `gyrorig solve` does. Stated are, by
the number of the board, the median total standard uncertainty of the misalignment and how often
its error is within twice that.

Run: python tests/bench/bench_unit.py [--rigs N] [--boards N] [--lean-mrad E] [--out FILE]
"""

import argparse
import contextlib
import io
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.bench.bench_uncertainty import PLACES, record, show

from gyrorig_solver import cli
from gyrorig_solver.check.true_values import _true_values
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.uncertainty import default_settings

AXES = ("x", "y", "z")
LEAN = "axis_nonorthogonality"
RANDOM_PHASE = ("worm_error", "eccentricity")  # in the emulator


def draw_unit(generator: np.random.Generator, lean_rad: float | None) -> list[str]:
    """Return the hidden causes of one unit as `gyrorigd record --hide` takes them."""
    sizes = default_settings().prior_sizes
    angle = sizes[LEAN].size * generator.standard_normal() if lean_rad is None else lean_rad
    others = [
        name
        for name, term in catalogue().items()
        if term.is_persistent and name not in (LEAN, *RANDOM_PHASE)
    ]
    other = str(generator.choice(others))
    place = str(generator.choice(PLACES[other]))
    size = max(abs(generator.standard_normal()), 0.01) * sizes[other].size
    return [f"{LEAN}:{angle:.6g}", f"{other}{place}:{size:.6g}"]


def measure(program: str, seed: int, boards: int, lean_rad: float | None) -> dict[str, Any]:
    """Record and solve the boards of one unit."""
    hidden = draw_unit(np.random.default_rng(seed), lean_rad)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        out = Path(name) / "out"
        for number in range(boards):
            folder = Path(name) / str(number)
            folder.mkdir()
            path, truth = record(folder, program, 1000 * seed + number, hidden)
            with contextlib.redirect_stdout(io.StringIO()):
                cli.run(["--quiet", "solve", str(path), "--out", str(out)])
            written = sorted(out.glob(f"*/v{number + 1:04d}.yaml"))
            if not written:
                raise SystemExit(f"{path.name} of seed {seed} has no calibration")
            calibration = yaml.safe_load(written[0].read_text())
            (board,) = truth["boards"].values()
            stated = np.array(calibration["parameters"]["misalignment"]["value"], dtype=float)
            parameters = calibration["uncertainty"]["parameters"]
            rows.append(
                {
                    "error": (stated - _true_values(board)["misalignment"]).tolist(),
                    "total": [parameters[f"misalignment.{axis}"]["total"] for axis in AXES],
                    "verdict": calibration["trust"]["verdict"],
                    "contradicts": any(
                        "contradicts" in text for text in calibration["quality"]["warnings"]
                    ),
                }
            )
        versions = len(list((out / "rigs").glob("*/v*.yaml")))
    return {"seed": seed, "hidden": hidden, "boards": rows, "versions": versions}


def table(rigs: list[dict[str, Any]]) -> str:
    """Return totals and coverage by the number of the board."""
    error = np.array([[board["error"] for board in rig["boards"]] for rig in rigs])
    total = np.array([[board["total"] for board in rig["boards"]] for rig in rigs])
    lines = ["board   median total of y, z (mrad)   rms error of y, z (mrad)   within 2 totals"]
    for number in range(error.shape[1]):
        medians = 1e3 * np.median(total[:, number, 1:], axis=0)
        rms = 1e3 * np.sqrt(np.mean(error[:, number, 1:] ** 2, axis=0))
        inside = np.abs(error[:, number]) <= 2.0 * total[:, number]
        lines.append(
            f"{number + 1:5d}   {medians[0]:14.2f} {medians[1]:8.2f}   {rms[0]:14.2f} {rms[1]:8.2f}"
            f"   {int(inside.sum()):10d} of {inside.size}"
        )
    inside = np.abs(error[:, 1:]) <= 2.0 * total[:, 1:]
    changed = sum(board["contradicts"] for rig in rigs for board in rig["boards"])
    lines.append(f"with a stored posterior: {inside.mean():.3f} of {inside.size} within 2 totals")
    lines.append(f"{changed} boards contradicted the stored posterior")
    return "\n".join(lines)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=12)
    parser.add_argument("--boards", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--program", default="survey-40")
    parser.add_argument("--lean-mrad", type=float, help="of every rig, instead of a drawn one")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    lean_rad = None if given.lean_mrad is None else given.lean_mrad * 1e-3
    rigs = []
    for seed in range(given.seed, given.seed + given.rigs):
        rigs.append(measure(given.program, seed, given.boards, lean_rad))
        worst = max(
            abs(e) / t
            for board in rigs[-1]["boards"]
            for e, t in zip(board["error"], board["total"], strict=True)
        )
        show(f"{seed} {', '.join(rigs[-1]['hidden'])} | worst error {worst:.1f} totals")
    show(table(rigs))
    if given.out:
        given.out.write_text(json.dumps(rigs))


if __name__ == "__main__":
    main()
