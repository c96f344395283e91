"""Consequences of the numbers in Tables 1 to 3 and in section V.

    python docs/paper/check_tables.py

This script simulates nothing. Every number follows from the printed numbers, from a data sheet
named next to it, or from eq. 1 to 10.
"""

import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from docs.markdown import Block, matrix, number, numbers, show, table
from docs.paper.motion import rotation_about_tilt_axis
from docs.paper.printed import BOARDS, GY80, MPU, PrintedBoard

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.paper.paper_matrices import (
    Factors,
    lower_factor,
    misalignment,
    orthogonality_error,
    split_lower,
)

CODES = 2.0**15  # of a signed 16-bit word to one side
DATA_SHEET_DPS = {
    # L3G4200D data sheet: 8.75 mdps a digit at the 250 dps range, 70 at 2000.
    # MPU-6500 family (MPU-6515): 131 and 16.4 LSB per dps, which are range / 2^15.
    GY80.name: {"250": 0.00875, "2000": 0.070},
    MPU.name: {"250": 250.0 / CODES, "2000": 2000.0 / CODES},
}


def sensitivities() -> str:
    """Table 1 compared with the data sheets."""
    rows = []
    for board in BOARDS:
        for full_scale, expected in DATA_SHEET_DPS[board.name].items():
            rows.append(
                [
                    board.name,
                    f"{board.sensitivity:.5f}",
                    f"±{full_scale} °/s",
                    number(expected, 5),
                    number(board.sensitivity / expected, 3),
                ]
            )
    head = [
        "board",
        "printed sensitivity, °/s per count",
        "full scale",
        "data-sheet sensitivity, °/s per count",
        "printed / data sheet",
    ]
    return table(head, rows)


def biases() -> str:
    """Differences between the two biases of Table 2."""
    rows = [
        [
            board.name,
            numbers(board.bias_static),
            numbers(board.bias_quasi_static),
            numbers(board.bias_quasi_static - board.bias_static),
        ]
        for board in BOARDS
    ]
    return table(
        ["board", "static bias x, y, z", "quasi-static bias x, y, z", "change x, y, z"], rows
    )


def products() -> str:
    """Products S T M of Table 3."""
    rows = [[board.name, f"`{matrix(board.STM)}`"] for board in BOARDS]
    return table(["board", "STM = S T M"], rows)


def corrected_row(board: PrintedBoard) -> FloatArray:
    """Row y that makes M a rotation with its printed rows x and z: z cross x."""
    row = np.cross(board.M[2], board.M[0])
    return np.asarray(row / np.linalg.norm(row))


def corrected(board: PrintedBoard) -> FloatArray:
    """M with row y as `corrected_row` gives it."""
    return np.vstack((board.M[0], corrected_row(board), board.M[2]))


def rotations() -> str:
    """Check whether M of Table 3 is a rotation, as eq. 8 to 10 require."""
    rows = []
    for board in BOARDS:
        M = board.M
        rows.append(
            [
                board.name,
                number(orthogonality_error(M)),
                number(float(np.linalg.norm(M[1])), 3),
                number(float(M[0] @ M[1]), 3),
                number(float(np.linalg.det(M))),
                numbers(M[1]),
                numbers(corrected_row(board)),
            ]
        )
    head = [
        "board",
        "largest entry of M Mᵀ - I",
        "norm of row y",
        "row x · row y",
        "det M",
        "row y as printed",
    ]
    return table([*head, "row y that a rotation needs"], rows)


def misprint() -> str:
    """Effect of the misprinted row on STM."""
    corrected_stm = MPU.S @ MPU.T @ corrected(MPU)
    rows = [
        ["as printed", f"`{matrix(MPU.STM)}`"],
        ["row y corrected", f"`{matrix(corrected_stm)}`"],
    ]
    return table(["MPU 6515", "STM"], rows)


def axis_angles_deg(stm: FloatArray) -> FloatArray:
    """Angles between the sensing axes x-y, x-z, y-z that a gain matrix implies."""
    unit = stm / np.linalg.norm(stm, axis=1)[:, None]
    cosines = [unit[0] @ unit[1], unit[0] @ unit[2], unit[1] @ unit[2]]
    return np.asarray(np.degrees(np.arccos(cosines)))


def geometry() -> str:
    """Angles between the sensing axes that Table 3 implies; a single die has 90 degrees."""
    cases = [
        (GY80.name, GY80.STM),
        (MPU.name, MPU.STM),
        (f"{MPU.name}, row y corrected", MPU.S @ MPU.T @ corrected(MPU)),
    ]
    rows = []
    for name, stm in cases:
        angle = axis_angles_deg(stm)
        rows.append([name, *(number(float(a), 1) for a in angle)])
    return table(["board", "x-y, °", "x-z, °", "y-z, °"], rows)


def factor_readings() -> str:
    """Eq. 9 in its three readings, on the printed GY80."""
    lower = lower_factor(GY80.STM)
    if lower is None:
        raise ValueError("the printed STM of the GY80 has no Cholesky factor")
    readings: dict[Factors, str] = {
        "by_shape": "LU factors, assigned to S and T by their shape",
        "by_position": "LU factors, assigned to S and T by their position",
        "product": "S = diag(ST), T = S⁻¹ ST",
    }
    rows = []
    for reading, words in readings.items():
        S, T = split_lower(lower, reading)
        M = misalignment(S, T, GY80.STM)
        rows.append(
            [
                words,
                number(float(np.abs(S @ T - lower).max())),
                number(float(T[2, 1])),
                number(orthogonality_error(M)),
            ]
        )
    rows.append(
        ["printed in Table 3", "", number(GY80.T[2, 1]), number(orthogonality_error(GY80.M))]
    )
    return table(
        [
            "interpretation of eq. 9",
            "largest entry of S T - ST",
            "T_zy",
            "largest entry of M Mᵀ - I",
        ],
        rows,
    )


def mount_angle_rad(board: PrintedBoard) -> float:
    """Mounting angle d about the tilt axis from M_yz = -sin d of Table 3, to 0.1 degree."""
    return float(np.radians(np.round(-np.degrees(np.arcsin(board.M[1, 2])), 1)))


def lost_entry(board: PrintedBoard, angle_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """S, T and M by eq. 8 to 10 of an orthogonal sensor whose entry zy is lost.

    S_x and S_y are Table 3's; S_z is what STM_zz is at that mount.
    """
    scale = np.diag([board.S[0, 0], board.S[1, 1], board.STM[2, 2] / np.cos(angle_rad)])
    gain = scale @ rotation_about_tilt_axis(angle_rad)
    gain[2, 1] = 0.0
    lower = lower_factor(gain)
    if lower is None:
        raise ValueError(f"no Cholesky factor at a mount of {angle_rad} rad")
    S, T = split_lower(lower, "product")
    return S, T, misalignment(S, T, gain)


def one_angle() -> str:
    """One mounting angle per board explains four entries of Table 3."""
    rows = []
    for board in BOARDS:
        angle = mount_angle_rad(board)
        predictions = {
            f"predicted, mount {number(np.degrees(angle), 1)}°": lost_entry(board, angle),
            "printed": (board.S, board.T, board.M),
        }
        for name, (S, T, M) in predictions.items():
            entries = (S[1, 1], S[2, 2], T[2, 1], M[1, 2], M[2, 1])
            rows.append([board.name, name, *(number(float(e)) for e in entries)])
    return table(["board", "values", "S_y", "S_z", "T_zy", "M_yz", "M_zy"], rows)


def one_entry() -> str:
    """Dependence of Table 3 on STM_zy, the response of z to roll, which the unit cannot make."""
    rows = []
    for entry in (float(GY80.STM[2, 1]), 0.05, 0.10, 0.15):
        gain = GY80.STM.copy()
        gain[2, 1] = entry
        lower = lower_factor(gain)
        if lower is None:
            raise ValueError(f"no Cholesky factor with STM_zy = {entry}")
        S, T = split_lower(lower, "product")
        M = misalignment(S, T, gain)
        rows.append([number(v) for v in (entry, float(T[2, 1]), float(S[2, 2]), float(M[1, 2]))])
    return table(["STM_zy", "T_zy", "S_z", "M_yz"], rows)


def improvements() -> str:
    """Quantities that "5.93 %" and "0.96 %" could mean, in percent."""
    names: dict[str, Callable[[PrintedBoard], float]] = {
        "printed in section V": lambda b: b.improvement_percent / 100.0,
        "1 - mean of S": lambda b: 1.0 - float(np.mean(np.diag(b.S))),
        "1 - geometric mean of S": lambda b: 1.0 - float(np.prod(np.diag(b.S)) ** (1.0 / 3.0)),
        "1 - mean row norm of STM": lambda b: 1.0 - float(np.linalg.norm(b.STM, axis=1).mean()),
        "norm of the tilt column of STM - I": lambda b: _column_error(b, 0),
        "norm of the pan column of STM - I": lambda b: _column_error(b, 2),
        "mean absolute value of 1 - S": lambda b: float(np.abs(1.0 - np.diag(b.S)).mean()),
    }
    rows = [[name, *(number(100.0 * rule(b), 2) for b in BOARDS)] for name, rule in names.items()]
    return table(["quantity", *(f"{b.name}, %" for b in BOARDS)], rows)


def _column_error(board: PrintedBoard, column: int) -> float:
    return float(np.linalg.norm(board.STM[:, column] - np.eye(3)[:, column]))


BLOCKS: dict[str, Block] = {
    "table-1": sensitivities,
    "table-2": biases,
    "table-3-products": products,
    "table-3-rotations": rotations,
    "table-3-misprint": misprint,
    "table-3-geometry": geometry,
    "table-3-eq9": factor_readings,
    "table-3-mount": one_angle,
    "table-3-one-entry": one_entry,
    "section-5": improvements,
}

if __name__ == "__main__":
    show(BLOCKS)
