"""Products of few long rows: a handful of signals, each as long as a recording.

What to use when: `product` for what dense rows share with signals, `sparse_product` for
sparse ones. BLAS packs what is long and thin in vain: piece by piece, so that a cache holds
what is worked on, the same product takes a quarter of the time.
"""

import numpy as np
from scipy.sparse import csr_array

from gyrorig_solver.arrays import FloatArray

FEW = 20  # signals at once; more are worth packing
SMALL = 990_000  # multiplications at once: what OpenBLAS takes as small, and does not pack
TOGETHER = 16  # signals that sparse rows take at once: they are copied
LONGEST, SHORTEST = 4096, 64  # a piece


def product(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return first @ second.T of rows (a, n) and (b, n), shape (a, b)."""
    if len(second) > FEW or first is second:
        return np.asarray(first @ second.T, dtype=np.float64)
    total = np.zeros((len(first), len(second)))
    piece = SMALL // max(1, total.size)
    piece = max(SHORTEST, min(LONGEST, piece))
    for at in range(0, first.shape[1], piece):
        total += first[:, at : at + piece] @ second[:, at : at + piece].T
    return total


def sparse_product(first: csr_array, second: FloatArray) -> FloatArray:
    """Return first @ second.T of sparse rows (a, n) and rows (b, n), shape (a, b)."""
    found = np.empty((first.shape[0], len(second)))
    if len(second) > FEW:
        for at in range(0, len(second), TOGETHER):
            found[:, at : at + TOGETHER] = first @ second[at : at + TOGETHER].T
        return found
    for k, one in enumerate(second):
        found[:, k] = first @ one
    return found
