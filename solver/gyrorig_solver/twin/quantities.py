"""Values of a twin with their uncertainties, from numbers and arrays."""

import math

import numpy as np

from gyrorig_protocol.twin import Matrix, Scalar, Source, Vector
from gyrorig_solver.data import FloatArray


def scalar(
    value: float, std: float | None, unit: str, source: Source = "recording"
) -> Scalar | None:
    """Return a number, None if it is not finite."""
    if not math.isfinite(value):
        return None
    known = std is not None and math.isfinite(std)
    return Scalar(float(value), float(std) if known and std is not None else None, unit, source)


def vector(
    values: FloatArray, stds: FloatArray | None, unit: str, source: Source = "recording"
) -> Vector | None:
    """Return three numbers, None if one is not finite."""
    if not np.all(np.isfinite(values)):
        return None
    x, y, z = (float(value) for value in values)
    return Vector((x, y, z), _deviations(stds), unit, source)


def matrix(
    values: FloatArray, stds: FloatArray | None, unit: str, source: Source = "recording"
) -> Matrix:
    """Return a matrix of finite numbers, shape (3, 3)."""
    a, b, c = ((float(row[0]), float(row[1]), float(row[2])) for row in values)
    if stds is None:
        return Matrix((a, b, c), None, unit, source)
    d, e, f = ((float(row[0]), float(row[1]), float(row[2])) for row in stds)
    return Matrix((a, b, c), (d, e, f), unit, source)


def _deviations(stds: FloatArray | None) -> tuple[float, float, float] | None:
    if stds is None or not np.all(np.isfinite(stds)):
        return None
    return float(stds[0]), float(stds[1]), float(stds[2])
