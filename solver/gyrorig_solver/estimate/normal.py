"""The whitened normal equations of one series, without ever forming a dense Jacobian.

Model of axis i: y_i = G_i . omega(t - tau) + b_i + terms + noise. Unknowns: G (9, row by
row), b (3), tau, the terms' own, then the reference's shared unknowns; and its local ones
(one start to a move), which make the sparse side of an `Arrow`. Weighing is V_i^-1 =
D' diag(1/variance_i) D with D the orthonormal DCT. A long series is transformed part by
part, and the parts' constants among themselves: again an orthonormal transform, whose
coefficients have the densities of the whole series' at the same frequencies.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.fft import dct, idct
from scipy.sparse import coo_array, csc_array

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.arrow import Arrow
from gyrorig_solver.estimate.lanes import Lanes, products
from gyrorig_solver.estimate.noise import NoiseModel, frequencies
from gyrorig_solver.estimate.predict import PartColumns

OWN = 13  # G, b, tau


@dataclass(frozen=True, slots=True, eq=False)
class PartModel:
    """Block means of one part of a series at one set of parameters."""

    rate: FloatArray  # (n, 3), stage
    used: BoolArray  # (n,)
    terms: FloatArray  # (k, n, 3), derivatives by the terms' parameters, sensor frame
    columns: PartColumns
    _kept: dict[str, FloatArray] = field(default_factory=dict)

    def spectra(self) -> FloatArray:
        """Return the DCT of what acts everywhere: (7 + 3 g' + 3 k, n), kept once made."""
        if "everywhere" not in self._kept:
            used = self.used.astype(np.float64)
            rows = [self.rate.T, np.ones((1, used.size)), -self.columns.slope.T]
            rows += [column.T for column in self.columns.shared]
            rows += [column.T for column in self.terms]
            stacked = np.concatenate(rows) * used
            self._kept["everywhere"] = _dct(stacked)
        return self._kept["everywhere"]

    def lane_spectra(self) -> FloatArray:
        """Return the DCT of the lanes, unused blocks zero, (3, lanes, n), kept once made."""
        if "lanes" not in self._kept:
            used = self.used.astype(np.float64)
            self._kept["lanes"] = _dct(self.columns.lanes.values.transpose(2, 0, 1) * used)
        return self._kept["lanes"]


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

    def __init__(self, noise: NoiseModel, gain: FloatArray, local: int, first: PartModel) -> None:
        """Begin at zero.

        Args:
            noise: density of the residual.
            gain: G, shape (3, 3), at which derivatives are taken.
            local: how many local unknowns the reference has.
            first: any part, to know how many terms and shared unknowns there are.
        """
        self._noise, self._gain, self._local = noise, gain, local
        self._terms, self._shared = first.terms.shape[0], first.columns.shared.shape[0]
        size = OWN + self._terms + self._shared
        self._information, self._score = np.zeros((size, size)), np.zeros(size)
        self._cross, self._local_score = np.zeros((local, size)), np.zeros(local)
        self._near: list[tuple[IntArray, IntArray, FloatArray]] = []
        self._constants: list[FloatArray] = []
        self._blocks = 0

    def add(self, part: PartModel, residual: FloatArray, whole: bool) -> None:
        """Add a part with its residual, shape (n, 3), zero where unused.

        `whole`: the part is all of its series; else its constant waits for the others'.
        """
        n = residual.shape[0]
        self._blocks += n
        deviation = np.sqrt(self._noise.variance(n))
        everywhere, left = part.spectra(), _dct(np.ascontiguousarray(residual.T))
        lanes = part.columns.lanes
        felt = np.zeros((3, *lanes.values.shape[:2]))
        constants = []
        for axis in range(3):
            columns = self._sensor(everywhere, axis)
            constants.append(np.append(columns[:, 0], left[axis, 0]))
            white = np.vstack([columns, left[axis]]) / deviation[:, axis]
            if lanes.count:
                spectra = np.einsum("a,aln->ln", self._gain[axis], part.lane_spectra())
                felt[axis] = idct(spectra / deviation[:, axis], axis=-1, norm="ortho")
                self._locals(lanes, axis, felt[axis], idct(white, axis=-1, norm="ortho"))
            if not whole:
                white[:, 0] = 0.0
            self._gather(axis, white[:-1] @ white[:-1].T, white[:-1] @ white[-1])
        if not whole:
            self._constants.append(np.stack(constants))
        if lanes.count:
            self._near.append(products(lanes, felt))

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

    def _sensor(self, stage: FloatArray, axis: int) -> FloatArray:
        """Return one axis' columns: rate (3), bias, tau, terms, shared."""
        row, shared = self._gain[axis], self._shared
        n = stage.shape[1]
        columns = np.empty((5 + self._terms + shared, n))
        columns[:4] = stage[:4]
        columns[4] = row @ stage[4:7]
        after = 7 + 3 * shared
        columns[5 : 5 + self._terms] = stage[after + axis :: 3]
        columns[5 + self._terms :] = np.einsum(
            "a,gan->gn", row, stage[7:after].reshape(shared, 3, n)
        )
        return columns

    def _index(self, axis: int) -> IntArray:
        own = [3 * axis, 3 * axis + 1, 3 * axis + 2, 9 + axis, 12]
        return np.array([*own, *range(OWN, self._score.size)], dtype=np.int64)

    def _gather(self, axis: int, information: FloatArray, score: FloatArray) -> None:
        index = self._index(axis)
        self._information[np.ix_(index, index)] += information
        self._score[index] += score

    def _locals(self, lanes: Lanes, axis: int, felt: FloatArray, white: FloatArray) -> None:
        """Add one axis' share of the local unknowns against everything, all whitened."""
        index, everything = self._index(axis), np.ascontiguousarray(white.T)
        spots = zip(lanes.lane.tolist(), lanes.first.tolist(), lanes.stop.tolist(), strict=True)
        found = np.array([felt[lane, a:b] @ everything[a:b] for lane, a, b in spots])
        found *= lanes.scale[:, None]
        self._cross[np.ix_(lanes.unknown, index)] += found[:, :-1]
        self._local_score[lanes.unknown] += found[:, -1]

    def _between(self) -> None:
        """Weigh the constants of the parts: the lowest frequencies of the whole series."""
        constants = np.stack(self._constants, axis=-1)  # (3, columns + residual, parts)
        count = constants.shape[-1]
        f = frequencies(self._blocks, self._noise.sampling.rate_hz)[:count]
        variance = self._noise.density(f) * self._noise.sampling.rate_hz / 2.0
        spectra = _dct(constants)
        for axis in range(3):
            columns, left = spectra[axis, :-1], spectra[axis, -1]
            weighed = columns / variance[:, axis]
            self._gather(axis, weighed @ columns.T, weighed @ left)


def whitened(residuals: Sequence[FloatArray], noise: NoiseModel) -> FloatArray:
    """Return a series' residual in units of its own deviation, white, shape (n, 3).

    Args:
        residuals: of its parts, shape (n_p, 3) each.
        noise: its density.
    """
    found = []
    for residual in residuals:
        spectrum = _dct(residual.T) / np.sqrt(noise.variance(residual.shape[0]).T)
        found.append(idct(spectrum, axis=-1, norm="ortho").T)
    return np.asarray(np.concatenate(found), dtype=np.float64)


def _dct(signals: FloatArray) -> FloatArray:
    return np.asarray(dct(signals, axis=-1, norm="ortho"), dtype=np.float64)
