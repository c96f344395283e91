"""One part of a series, whitened: what the normal equations are sums of.

Weighing is V_i^-1 = D' diag(1/variance_i) D with D the orthonormal DCT. Everything that
acts for long is whitened as a spectrum, what acts for a moment as a signal.

What to use when: `PartModel` for derivatives as block means; `WhitePart.of` for the same at
a gain and a noise; its `score` alone where a later round changes only the residual.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from scipy.fft import dct, idct

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.estimate.chain import Shown
from gyrorig_solver.estimate.lanes import Lanes
from gyrorig_solver.estimate.noise import NoiseModel
from gyrorig_solver.estimate.predict import PartColumns

OWN = 13  # G, b, tau


@dataclass(frozen=True, slots=True, eq=False)
class PartModel:
    """Block means of one part of a series at one set of parameters."""

    rate: FloatArray  # (n, 3), stage
    used: BoolArray  # (n,)
    terms: FloatArray  # (k, n, 3), derivatives by the terms' parameters, sensor frame
    columns: PartColumns
    shown: Shown | None = None  # what causes that cut rates off let pass
    _kept: dict[str, FloatArray] = field(default_factory=dict)

    def spectra(self) -> FloatArray:
        """Return the DCT of what acts everywhere: (7 + 3 g' + 3 k, n), kept once made."""
        if "everywhere" not in self._kept:
            used = self.used.astype(np.float64)
            rows = [self.rate.T, np.ones((1, used.size)), -self.columns.slope]
            rows += list(self.columns.shared)
            rows += [column.T for column in self.terms]
            stacked = np.concatenate(rows) * used
            self._kept["everywhere"] = dct_of(stacked)
        return self._kept["everywhere"]

    def own(self, gain: FloatArray) -> FloatArray:
        """Return the derivatives by G, b and tau, sensor frame, (13, n, 3).

        Args:
            gain: G, shape (3, 3).
        """
        found = np.zeros((OWN, self.used.size, 3))
        for axis in range(3):
            found[3 * axis : 3 * axis + 3, :, axis] = self.rate.T
            found[9 + axis, :, axis] = 1.0
        found[12] = -(gain @ self.columns.slope).T
        if self.shown is not None:
            for axis in range(3):
                found[3 * axis : 3 * axis + 3, :, axis] += self.shown.gain[axis]
            found[9:12] *= self.shown.after
            found[12] *= self.shown.before
        return found

    def shared(self, gain: FloatArray) -> FloatArray:
        """Return the derivatives by the reference's shared unknowns, sensor frame, (g, n, 3)."""
        found: FloatArray = np.einsum("ij,gjn->gni", gain, self.columns.shared)
        return found if self.shown is None else found * self.shown.before

    def lane_signals(self, gain: FloatArray) -> FloatArray:
        """Return the lanes' DCT in the sensor's frame, unused blocks zero, (3, lanes, n)."""
        if self.shown is None:
            return np.tensordot(gain, self.lane_spectra(), axes=1)
        lanes = np.tensordot(gain, self.columns.lanes.values.transpose(1, 0, 2), axes=1)
        return dct_of(lanes * (self.shown.before.T * self.used)[:, None, :])

    def lane_spectra(self) -> FloatArray:
        """Return the DCT of the lanes, unused blocks zero, (3, lanes, n), kept once made."""
        if "lanes" not in self._kept:
            used = self.used.astype(np.float64)
            self._kept["lanes"] = dct_of(self.columns.lanes.values.transpose(1, 0, 2) * used)
        return self._kept["lanes"]


@dataclass(frozen=True, slots=True, eq=False)
class WhitePart:
    """A part's derivatives over (G, b, tau, terms, shared) and its local ones, whitened.

    Each axis has columns for its row of G (3), its bias, tau, the terms and the shared
    unknowns: see `index`.
    """

    columns: FloatArray  # (3, q, n), spectra
    lanes: Lanes
    felt: FloatArray  # (3, lanes, n), signals
    deviation: FloatArray  # (n, 3), of each coefficient

    @classmethod
    def of(cls, part: PartModel, gain: FloatArray, noise: NoiseModel) -> Self:
        """Whiten a part.

        Args:
            part: its derivatives at the stage.
            gain: G, shape (3, 3), at which they are taken to the sensor.
            noise: density of the residual.
        """
        n = part.used.size
        deviation = np.sqrt(noise.variance(n))
        everywhere, lanes = part.spectra(), part.columns.lanes
        shared = part.columns.shared.shape[0]
        columns = np.stack(
            [
                _sensor(everywhere, gain[axis], axis, shared) / deviation[:, axis]
                for axis in range(3)
            ]
            if part.shown is None
            else [_cut(part, gain, axis) / deviation[:, axis] for axis in range(3)]
        )
        felt = np.zeros((3, lanes.values.shape[0], n))
        if lanes.count:
            felt = idct(part.lane_signals(gain) / deviation.T[:, None, :], axis=-1, norm="ortho")
        return cls(columns, lanes, np.asarray(felt, dtype=np.float64), deviation)

    def index(self, axis: int) -> IntArray:
        """Return which parameters an axis' columns belong to."""
        own = [3 * axis, 3 * axis + 1, 3 * axis + 2, 9 + axis, 12]
        return np.array([*own, *range(OWN, self.size)], dtype=np.int64)

    @property
    def size(self) -> int:
        """How many parameters there are beside the local ones."""
        return int(self.columns.shape[1]) - 5 + OWN

    def white(self, residual: FloatArray) -> FloatArray:
        """Return the whitened spectrum of a residual (n, 3), shape (3, n)."""
        return dct_of(np.ascontiguousarray(residual.T)) / self.deviation.T

    def local_score(self, white: FloatArray) -> FloatArray:
        """Return the score of each local column against a whitened spectrum (3, n)."""
        if not self.lanes.count:
            return np.zeros(0)
        signal = np.asarray(idct(white, axis=-1, norm="ortho"), dtype=np.float64)
        total = np.zeros((self.felt.shape[1], self.felt.shape[2] + 1))
        np.cumsum(np.einsum("iln,in->ln", self.felt, signal), axis=1, out=total[:, 1:])
        lanes = self.lanes
        part = total[lanes.lane, lanes.stop] - total[lanes.lane, lanes.first]
        return np.asarray(part * lanes.scale, dtype=np.float64)


def _sensor(stage: FloatArray, row: FloatArray, axis: int, shared: int) -> FloatArray:
    """Return one axis' columns: rate (3), bias, tau, terms, shared."""
    n = stage.shape[1]
    after = 7 + 3 * shared
    terms = stage[after + axis :: 3]
    columns = np.empty((5 + terms.shape[0] + shared, n))
    columns[:4] = stage[:4]
    columns[4] = row @ stage[4:7]
    columns[5 : 5 + terms.shape[0]] = terms
    columns[5 + terms.shape[0] :] = np.einsum(
        "a,gan->gn", row, stage[7:after].reshape(shared, 3, n)
    )
    return columns


def _cut(part: PartModel, gain: FloatArray, axis: int) -> FloatArray:
    """Return one axis' columns as `_sensor`, of what the causes that cut rates off let pass."""
    own = part.own(gain)[[3 * axis, 3 * axis + 1, 3 * axis + 2, 9 + axis, 12], :, axis]
    rows = np.concatenate([own, part.terms[:, :, axis], part.shared(gain)[:, :, axis]])
    return dct_of(rows * part.used)


def whitened(residuals: Sequence[FloatArray], noise: NoiseModel) -> FloatArray:
    """Return a series' residual in units of its own deviation, white, shape (n, 3).

    Args:
        residuals: of its parts, shape (n_p, 3) each.
        noise: its density.
    """
    found = []
    for residual in residuals:
        spectrum = dct_of(residual.T) / np.sqrt(noise.variance(residual.shape[0]).T)
        found.append(idct(spectrum, axis=-1, norm="ortho").T)
    return np.asarray(np.concatenate(found), dtype=np.float64)


def dct_of(signals: FloatArray) -> FloatArray:
    """Return the orthonormal DCT along the last axis."""
    return np.asarray(dct(signals, axis=-1, norm="ortho"), dtype=np.float64)
