"""Wrong axes and wrong units of a gyro, as seen against the gravity of its accelerometer.

What to use when: `list_mismatches` if a fit to gravity fails, to find the column map that agrees.

Theory of operation. A rotation of gravity does not change if all axes of the accelerometer are
reversed. An accelerometer with permuted or reversed axes is therefore the same as a gyro that is
rotated by quarter turns, and 24 of the 48 signed permutations of the gyro describe it. The other 24
are a mirrored gyro.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from gyrorig_solver.data import FloatArray

# The imported rotation, as a multiple of the true one.
UNITS = {
    float(np.degrees(1.0)): (
        "the gyro turns 57 times as far as gravity, as if its rates are in deg/s and the column "
        "map states rad/s"
    ),
    float(np.radians(1.0)): (
        "gravity turns 57 times as far as the gyro, as if its rates are in rad/s and the column "
        "map states deg/s"
    ),
    1000.0: (
        "the gyro turns 1000 times as far as gravity, as if the times are in ms and the column map "
        "states s"
    ),
}


@dataclass(frozen=True, slots=True, eq=False)
class Mismatch:
    """One wrong column map."""

    correction: FloatArray  # (3, 3), from the rates as imported to the rates in rad/s
    text: str


def list_mismatches() -> Iterator[Mismatch]:
    """Yield every wrong map: permuted or reversed axes, and wrong units.

    The map as it is comes first, without a text.
    """
    for factor, unit_text in {1.0: "", **UNITS}.items():
        for axes in _signed_permutations():
            texts = (unit_text, _axes_text(axes))
            yield Mismatch(axes / factor, ". Also, ".join(text for text in texts if text))


def _signed_permutations() -> Iterator[FloatArray]:
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            yield np.array(signs)[:, None] * np.eye(3)[list(order)]


def _axes_text(axes: FloatArray) -> str:
    """Describe the columns that agree, empty if they are those of the map."""
    if np.array_equal(axes, np.eye(3)):
        return ""
    gyro_text = f"the columns of the gyro are {_column_names(axes)}"
    if np.linalg.det(axes) < 0.0:
        return f"the axes of gyro and accelerometer do not agree: they agree if {gyro_text}"
    # Which way gravity points does not matter, so the map with fewer reversed axes is named.
    accel_axes = axes.T if axes.sum() > -axes.sum() else -axes.T
    return (
        "the axes of gyro and accelerometer do not agree: they agree if the columns of the "
        f"accelerometer are {_column_names(accel_axes)}, or if {gyro_text}"
    )


def _column_names(axes: FloatArray) -> str:
    """Return the columns as imported that are x, y and z of the corrected vector."""
    return ", ".join(
        "xyz"[int(np.argmax(np.abs(row)))].rjust(1 + int(row.sum() < 0.0), "-") for row in axes
    )
