"""Errors of eq. 6 to 12 on pan-tilt paths with a perfect gyro.

    python docs/paper/check_paths.py

The gyro has no bias, no noise, unit gain and no mounting angle. A correct method therefore gives
STM = I and b = 0.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from docs.markdown import Block, matrix, number, numbers, show, table
from docs.paper.motion import Corners, Motion, along, calibrated, paths

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.paper.paper_angles import (
    Composition,
    composed_attitude,
    euler_angles_rad,
    ideal_integral_rad,
    mechanism_angles_rad,
)
from gyrorig_solver.estimate.paper.paper_method import FAILURES, ONE_STEP_RAD, PaperReading


def rank_above_step(columns: FloatArray) -> int:
    """Directions of (n, 3) angles that move by more than one step of the unit, rms."""
    singular = np.linalg.svd(columns, compute_uv=False)
    return int(np.count_nonzero(singular > ONE_STEP_RAD * np.sqrt(columns.shape[0])))


def composition_example() -> str:
    """Angles after a tilt of 30 degrees at a pan of 60 degrees, by each reading of eq. 12."""
    corners: Corners = [(0.0, 0.0), (60.0, 0.0), (60.0, 30.0)]
    motion = along(corners)
    words: dict[Composition, str] = {
        "printed": "as printed: both increments from the left",
        "right": "both increments from the right",
        "mechanism": "pan from the left, tilt from the right, as the unit turns",
    }
    rows = []
    for composition, text in words.items():
        attitude = composed_attitude(motion.pan_rad, motion.tilt_rad, composition)
        rows.append(
            [text, *(number(float(a), 1) for a in np.degrees(euler_angles_rad(attitude)[-1]))]
        )
    return table(
        ["interpretation of eq. 12", "about x (tilt), °", "about y (roll), °", "about z (pan), °"],
        rows,
    )


def ranks() -> str:
    """Rank of U for every path and every reading of eq. 12."""
    rows = []
    for name, corners in paths().items():
        motion = along(corners)
        angles = [
            euler_angles_rad(composed_attitude(motion.pan_rad, motion.tilt_rad, composition))
            for composition in ("mechanism", "printed", "right")
        ]
        roll_deg = np.degrees(np.abs(angles[1][:, 1]).max())
        rows.append([name, *(str(rank_above_step(a)) for a in angles), number(roll_deg, 1)])
    head = [
        "path",
        "rank with true angles",
        "rank with eq. 12 as printed",
        "rank with both increments from the right",
    ]
    return table([*head, "largest roll in eq. 12 as printed, °"], rows)


def offsets_deg(motion: Motion) -> tuple[FloatArray, FloatArray]:
    """Integral of a perfect gyro minus the unit's angle: at the end and largest, (3,) each."""
    pan, tilt = motion.pan_rad, motion.tilt_rad
    apart = np.degrees(ideal_integral_rad(pan, tilt) - mechanism_angles_rad(pan, tilt))
    return np.asarray(apart[-1]), np.asarray(np.abs(apart).max(axis=0))


def false_bias_dps(motion: Motion) -> FloatArray:
    """Quasi-static bias that the paper finds for a gyro without bias, shape (3,)."""
    result = calibrated(motion, motion.body_rate_rad_s(), "quasi_static")
    return np.asarray(np.degrees(result.bias_quasi_static_rad_s))


def geometric_phase() -> str:
    """Integrated rates of a perfect gyro, and the slope of a line through them."""
    rows = []
    for name, corners in paths().items():
        motion = along(corners)
        end, most = offsets_deg(motion)
        rows.append(
            [name, numbers(end[1:], 1), numbers(most[1:], 1), numbers(false_bias_dps(motion), 3)]
        )
    head = [
        "path",
        "difference at the end about y, z, °",
        "largest difference about y, z, °",
        "false bias about x, y, z, °/s",
    ]
    return table(head, rows)


def gains() -> str:
    """STM of eq. 7 for a perfect gyro, with its true bias of zero."""
    rows = []
    for name, corners in paths().items():
        motion = along(corners)
        result = calibrated(motion, motion.body_rate_rad_s(), "static")
        if result.S is None or result.T is None:
            split = "no Cholesky factor"
        else:
            split = f"S {numbers(np.diag(result.S), 2)}; T_zy {number(result.T[2, 1], 2)}"
        rows.append([name, str(result.rank), f"`{matrix(result.STM, 2)}`", split])
    return table(["path", "rank of U", "STM (correct: identity)", "result of eq. 8 to 10"], rows)


def both_biases() -> str:
    """Static and quasi-static bias on path A, on which integrals and angles agree."""
    name, corners = next(iter(paths().items()))
    motion = along(corners)
    rows = []
    for bias in ("static", "quasi_static"):
        result = calibrated(motion, motion.body_rate_rad_s(), bias)
        rows.append(
            [
                bias.replace("_", "-"),
                numbers(np.degrees(result.bias_rad_s), 3),
                f"`{matrix(result.STM, 3)}`",
            ]
        )
    return table(
        [
            "bias",
            "bias value x, y, z, °/s",
            f"STM of path {name} (correct: identity without column y)",
        ],
        rows,
    )


def rounding() -> str:
    """Eq. 7 with Matlab's tolerance on paths whose roll is only a sampling error."""
    rows = []
    for name in ("A pan out and back, tilt out and back", "E pan out and back at the tilt end"):
        motion = along(paths()[name])
        reading = PaperReading(order="axes")
        result = calibrated(motion, motion.body_rate_rad_s(), "static", reading)
        roll_rms = result.singular_values_rad[-1] / np.sqrt(result.time_s.size)
        largest = np.abs(result.STM[:, 1]).max()
        rows.append([name, str(result.rank), f"{roll_rms:.0e}", f"{largest:.0e}"])
    head = ["path", "rank of U by `pinv`", "smallest motion along a direction, rad rms"]
    return table([*head, "largest entry of STM's roll column"], rows)


def failures() -> str:
    """The failures that `PaperResult` can report, with their meaning."""
    return table(["name", "meaning"], [[f"`{name}`", FAILURES[name]] for name in FAILURES])


BLOCKS: dict[str, Block] = {
    "failures": failures,
    "paths-composition": composition_example,
    "paths-ranks": ranks,
    "paths-phase": geometric_phase,
    "paths-gains": gains,
    "paths-bias": both_biases,
    "paths-rounding": rounding,
}

if __name__ == "__main__":
    show(BLOCKS)
