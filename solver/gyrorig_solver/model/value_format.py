"""Formats of the numbers in the sentences of causes, in the units that engineers use at the rig."""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.data import FloatArray

DEG = np.pi / 180.0
XYZ = ("x", "y", "z")
PAN_TILT = ("pan", "tilt")


def format_list(values: FloatArray, names: Sequence[str], unit: str) -> str:
    """Return "x 0.01, y 0.2, z 0 unit"."""
    return ", ".join(f"{n} {v:.3g}" for n, v in zip(names, values, strict=True)) + f" {unit}"
