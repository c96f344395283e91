"""The whitened normal equations of one series, without ever forming a dense Jacobian.

Model of axis i: y_i = G_i . omega(t - tau) + b_i + terms + noise. Unknowns: G (9, row by
row), b (3), tau, the terms' own, then the reference's shared unknowns; and its local ones
(one start to a move), which make the sparse side of an `Arrow`. A long series is
transformed part by part, and the parts' constants among themselves: again an orthonormal
transform, whose coefficients have the densities of the whole series' at the same
frequencies.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import idct
from scipy.sparse import coo_array, csc_array

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.arrow import Arrow
from gyrorig_solver.estimate.lanes import products
from gyrorig_solver.estimate.noise import NoiseModel, frequencies
from gyrorig_solver.estimate.whitening import WhitePart, dct_of


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """Information and score over (local | G, b, tau, terms, shared)."""

    matrix: Arrow
    score: FloatArray  # local ones first

    def __add__(self, other: "Normal") -> "Normal":
        """Add the evidence of another series."""
        return Normal(self.matrix + other.matrix, self.score + other.score)


class NormalSum:
    """The normal equations of one series, summed part by part."""

    def __init__(self, noise: NoiseModel, local: int, size: int) -> None:
        """Begin at zero.

        Args:
            noise: density of the residual.
            local: how many local unknowns the reference has.
            size: how many other parameters there are.
        """
        self._noise, self._local = noise, local
        self._information, self._score = np.zeros((size, size)), np.zeros(size)
        self._cross, self._local_score = np.zeros((local, size)), np.zeros(local)
        self._near: list[tuple[IntArray, IntArray, FloatArray]] = []
        self._constants: list[FloatArray] = []
        self._indices: list[IntArray] = []
        self._blocks = 0

    def add(self, part: WhitePart, residual: FloatArray, whole: bool) -> None:
        """Add a part with its residual, shape (n, 3), zero where unused.

        `whole`: the part is all of its series; else its constant waits for the others'.
        """
        self._blocks += residual.shape[0]
        self._indices = [part.index(axis) for axis in range(3)]
        left = part.white(residual)
        if part.lanes.count:
            self._cross[part.lanes.unknown] += _cross(part, self._score.size)
            self._local_score[part.lanes.unknown] += part.local_score(left)
            self._near.append(products(part.lanes, part.felt))
        first = 0
        if not whole:
            both = np.concatenate([part.columns[:, :, 0], left[:, :1]], axis=1)
            self._constants.append(both * part.deviation[0][:, None])
            first = 1
        for axis in range(3):
            columns = part.columns[axis, :, first:]
            self._gather(axis, columns @ columns.T, columns @ left[axis, first:])

    def total(self) -> Normal:
        """Return the sum, the parts' constants weighed together."""
        if self._constants:
            self._between()
        rows, columns, values = (
            np.concatenate([found[k] for found in self._near] or [np.zeros(0, dtype)])
            for k, dtype in enumerate((np.int64, np.int64, np.float64))
        )
        shape = (self._local, self._local)
        near = csc_array(coo_array((values, (rows, columns)), shape=shape))
        matrix = Arrow(near, self._cross, self._information)
        return Normal(matrix, np.concatenate([self._local_score, self._score]))

    def _gather(self, axis: int, information: FloatArray, score: FloatArray) -> None:
        index = self._indices[axis]
        self._information[np.ix_(index, index)] += information
        self._score[index] += score

    def _between(self) -> None:
        """Weigh the constants of the parts: the lowest frequencies of the whole series."""
        constants = np.stack(self._constants, axis=-1)  # (3, columns + residual, parts)
        count = constants.shape[-1]
        f = frequencies(self._blocks, self._noise.sampling.rate_hz)[:count]
        variance = self._noise.density(f) * self._noise.sampling.rate_hz / 2.0
        spectra = dct_of(constants)
        for axis in range(3):
            columns, left = spectra[axis, :-1], spectra[axis, -1]
            weighed = columns / variance[:, axis]
            self._gather(axis, weighed @ columns.T, weighed @ left)


def score_again(part: WhitePart, residual: FloatArray, local: int) -> FloatArray:
    """Return a series' score at another residual, local unknowns first.

    Args:
        part: all of the series, whitened before.
        residual: shape (n, 3).
        local: how many local unknowns the reference has.
    """
    left = part.white(residual)
    score = np.zeros(local + part.size)
    score[part.lanes.unknown] = part.local_score(left)
    for axis in range(3):
        score[local + part.index(axis)] += part.columns[axis] @ left[axis]
    return score


def _cross(part: WhitePart, size: int) -> FloatArray:
    """Return the products of each local column with all others, (c, size)."""
    lanes = part.lanes
    found = np.zeros((lanes.count, size))
    spots = list(zip(lanes.lane.tolist(), lanes.first.tolist(), lanes.stop.tolist(), strict=True))
    for axis in range(3):
        signals = np.ascontiguousarray(idct(part.columns[axis], axis=-1, norm="ortho").T)
        felt = part.felt[axis]
        own = np.array([felt[lane, a:b] @ signals[a:b] for lane, a, b in spots])
        found[:, part.index(axis)] += own
    return found * lanes.scale[:, None]
