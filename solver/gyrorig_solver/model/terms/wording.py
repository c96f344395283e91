"""How the causes' sentences say their numbers: in units that a rig's people use."""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.arrays import FloatArray

DEG = np.pi / 180.0
XYZ = ("x", "y", "z")
PAN_TILT = ("pan", "tilt")


def listed(values: FloatArray, names: Sequence[str], unit: str) -> str:
    """Return "x 0.01, y 0.2, z 0 unit"."""
    return ", ".join(f"{n} {v:.3g}" for n, v in zip(names, values, strict=True)) + f" {unit}"


def largest(values: FloatArray, names: Sequence[str], unit: str) -> str:
    """Return the largest of some values with its name."""
    k = int(np.argmax(np.abs(values)))
    return f"{names[k]} {values[k]:.3g} {unit}"
