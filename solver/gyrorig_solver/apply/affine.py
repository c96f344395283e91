"""The arithmetic of applying a calibration to many samples at once.

What to use when: `transformed` for readings of one board. It takes counts of any width or
rates, and works through them in blocks that stay in the processor's cache.

How it is fast: a product of many rows with a 3 x 3 matrix is nearly all call and little
arithmetic, for BLAS works in blocks far larger than 3. So four samples are read as one row
of 12 numbers, and multiplied by a 12 x 12 matrix that holds the small one four times: a
quarter of the products count, and it is still several times as fast.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrorig_solver.arrays import FloatArray

TOGETHER = 4  # samples in one row
BLOCK = 2048 * TOGETHER  # samples at a time: 200 kB as float64, which a second-level cache holds

Readings = NDArray[Any]  # whole numbers or floats, shape (n, 3)
Output = NDArray[Any]  # float32 or float64, shape (n, 3)


def transformed(
    readings: Readings, matrix: FloatArray, offset: FloatArray, out: Output | None = None
) -> Output:
    """Return `matrix @ reading + offset` of every reading, shape (n, 3).

    Args:
        readings: shape (n, 3), counts or rates.
        matrix: shape (3, 3), rows first.
        offset: shape (3,).
        out: where to write, shape (n, 3), float32 or float64, each row behind the other;
            float64 of its own without it.

    Raises:
        ValueError: `out` has another shape, is not of floats, or is not contiguous.
    """
    count = readings.shape[0]
    if out is None:
        out = np.empty((count, 3))
    elif out.shape != readings.shape or out.dtype not in (np.float32, np.float64):
        raise ValueError(f"out is {out.dtype} of shape {out.shape}, not floats of ({count}, 3)")
    elif not out.flags.c_contiguous:
        raise ValueError("out is not contiguous")
    kind = out.dtype
    small = np.asarray(matrix).T.astype(kind)
    wide = np.kron(np.eye(TOGETHER, dtype=kind), small)
    tall = np.tile(np.asarray(offset), TOGETHER).astype(kind)
    rows = np.empty((BLOCK // TOGETHER, 3 * TOGETHER), dtype=kind)
    whole = count - count % TOGETHER
    for start in range(0, whole, BLOCK):
        end = min(start + BLOCK, whole)
        part = readings[start:end]
        used = rows[: (end - start) // TOGETHER]
        if part.dtype == kind and part.flags.c_contiguous:
            used = part.reshape(used.shape)
        else:
            used.reshape(-1, 3)[...] = part
        target = out[start:end].reshape(-1, 3 * TOGETHER)
        if part.dtype.kind == "f" and not np.isfinite(used.sum()):
            # 0 times nan is nan: one reading that is missing would spoil its three neighbours
            np.matmul(used.reshape(-1, 3), small, out=out[start:end])
        else:
            np.matmul(used, wide, out=target)
        target += tall
    out[whole:] = readings[whole:].astype(kind) @ small
    out[whole:] += tall[:3]
    return out
