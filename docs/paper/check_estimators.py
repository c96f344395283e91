"""Compare the paper's method with least squares on the rates, on one simulated GY80.

    python docs/paper/check_estimators.py

The board has the scales of Table 3, a T_zy of -0.005, a mount turned by 8.8 degrees about the
tilt axis, the static bias of Table 2 taken as degrees per second and the noise of an L3G4200D.
The least-squares fit is y = G omega + b with the pan-tilt rates; end_to_end.py gives the results of
the project's solver.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from docs.markdown import Block, number, show, table
from docs.paper.motion import (
    DURATION_S,
    NOISE_DPS_ROOT_HZ,
    RATE_HZ,
    Motion,
    along,
    calibrated,
    paths,
    rotation_about_tilt_axis,
    white_noise_rad_s,
)
from docs.paper.printed import GY80

from gyrorig_solver.data import FloatArray

SEED = 20160202
MOUNT_DEG = 8.8  # check_tables.py, table-3-mount
PATHS = ("A pan", "G rect", "H pan")
AMPLITUDES = ((60.0, 30.0), (20.0, 10.0))


def true_gain() -> FloatArray:
    """Gain matrix of the simulated board."""
    T = np.eye(3)
    T[2, 1] = -0.005
    scale = np.diag([0.948, 0.973, 0.906])  # Table 3, S_z as the mount makes it
    return np.asarray(scale @ T @ rotation_about_tilt_axis(np.radians(MOUNT_DEG)))


def samples_rad_s(motion: Motion, late_s: float = 0.0) -> FloatArray:
    """Return the readings of the board on `motion`, delayed by `late_s`."""
    ideal = motion.body_rate_rad_s()
    if late_s:
        at = motion.time_s - late_s
        ideal = np.column_stack([np.interp(at, motion.time_s, axis) for axis in ideal.T])
    noise = white_noise_rad_s(motion.time_s.size, SEED)
    return np.asarray(ideal @ true_gain().T + np.radians(GY80.bias_static) + noise)


def rate_design(motion: Motion) -> FloatArray:
    """Columns omega_x, omega_y, omega_z, 1 of the quasi-static test, shape (n, 4)."""
    moving = motion.body_rate_rad_s()[~motion.static]
    return np.column_stack((moving, np.ones(moving.shape[0])))


def unseen_directions(design: FloatArray) -> FloatArray:
    """Combinations of the columns that never occurred, columns of equal norm, shape (k, 4)."""
    norm = np.linalg.norm(design, axis=0)
    scaled = design / np.where(norm > 0.0, norm, 1.0)
    _, singular, right = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(right[singular < 1e-6 * singular[0]])


def rate_rank(design: FloatArray) -> int:
    """Return the columns of the design that the motion determines."""
    return int(design.shape[1]) - len(unseen_directions(design))


def rate_gain(motion: Motion, rate_rad_s: FloatArray) -> FloatArray:
    """G of y = G omega + b, shape (3, 3); a column without motion is nan."""
    design = rate_design(motion)
    solution, *_ = np.linalg.lstsq(design, rate_rad_s[~motion.static], rcond=None)
    gain = np.asarray(solution[:3].T)
    gain[:, np.linalg.norm(design[:, :3], axis=0) == 0.0] = np.nan
    return gain


def _error(gain: FloatArray, rank: int) -> str:
    """Return the largest error of an estimate, without the columns that are not observable."""
    apart = np.abs(gain - true_gain())
    if rank == 3:
        return number(float(apart.max()))
    return f"no column y; columns x and z: {number(float(apart[:, [0, 2]].max()))}"


def chosen(pan: float, tilt: float) -> dict[str, Motion]:
    """The three paths of the comparison at one amplitude."""
    return {
        f"{name}, ±{pan:.0f}/±{tilt:.0f}°": along(corners)
        for name, corners in paths(pan, tilt).items()
        if name.startswith(PATHS)
    }


def comparison() -> str:
    """Largest error of G for three estimators on the same samples."""
    rows = []
    cases = [(name, m, 0.0) for size in AMPLITUDES for name, m in chosen(*size).items()]
    late = [(f"{name}, samples 20 ms late", m, 0.02) for name, m, _ in cases[:1] + cases[1:3]]
    for name, motion, late_s in cases + late:
        rate = samples_rad_s(motion, late_s)
        line = calibrated(motion, rate, "quasi_static")
        static = calibrated(motion, rate, "static")
        design_rank = rate_rank(rate_design(motion)) - 1
        rows.append(
            [
                name,
                _error(line.STM, line.rank),
                _error(static.STM, static.rank),
                _error(rate_gain(motion, rate), design_rank),
            ]
        )
    head = [
        "path",
        "paper's method, quasi-static bias",
        "paper's method, static bias",
        "least squares on the rates",
    ]
    return table(head, rows)


def sight() -> str:
    """Return the rank of the 12 parameters and the bounds from noise for each path."""
    density = np.radians(NOISE_DPS_ROOT_HZ)
    rows = []
    for name, corners in paths().items():
        design = rate_design(along(corners))
        unseen = np.abs(unseen_directions(design)).max(axis=0, initial=0.0) > 1e-6
        # Cramer-Rao: information of white noise of one-sided density N is 2 / N^2 dt
        information = design.T @ design * (2.0 / density**2 / RATE_HZ)
        sigma = np.sqrt(np.diag(np.linalg.pinv(information, rcond=1e-12, hermitian=True)))
        bounds = [
            "none" if hidden else number(1e6 * float(s), 0)
            for hidden, s in zip(unseen[:3], sigma[:3], strict=True)
        ]
        rows.append([name, f"{3 * rate_rank(design)} of 12", *bounds])
    columns = [
        "std of column x (tilt), ppm",
        "std of column y (roll), ppm",
        "std of column z (pan), ppm",
    ]
    head = ["path", "observable parameters", *columns]
    return table(head, rows)


BLOCKS: dict[str, Block] = {"estimators": comparison, "sight": sight}

if __name__ == "__main__":
    print(f"{DURATION_S:.0f} s, {RATE_HZ:.0f} Hz, seed {SEED}\n")
    show(BLOCKS)
