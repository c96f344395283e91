"""Whitening: the derivatives of one part of a series in units of the noise.

The weight matrix is V_i^-1 = D' diag(1/variance_i) D with D the orthonormal DCT. Derivatives that
act at all times are whitened as spectra, local derivatives as signals. If the noise is larger in
motion, the whitened signals are then divided by its relative standard deviation: see
`relative_std`.

What to use when: `PartModel` for derivatives as block means; `WhitenedPart.of` for the same at a
gain and a noise; only its `local_score` if a later iteration changes only the residual.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from scipy.fft import idct

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.estimate.cascade import PassThrough
from gyrorig_solver.estimate.linear.gap_fill import GapFill, gap_fill
from gyrorig_solver.estimate.linear.packed_columns import PackedColumns
from gyrorig_solver.estimate.noise.noise_model import NoiseModel
from gyrorig_solver.estimate.noise.relative_std import RelativeStd, orthonormal_dct
from gyrorig_solver.estimate.reference_prediction import PartDerivatives

BASE_PARAMETERS = 13  # G, b, tau


@dataclass(frozen=True, slots=True, eq=False)
class PartModel:
    """Block means of one part of a series at one set of parameters."""

    rate: FloatArray  # (n, 3), stage
    used: BoolArray  # (n,)
    cause_derivatives: FloatArray  # (k, n, 3), by the terms' values, sensor frame
    columns: PartDerivatives
    pass_through: PassThrough | None = None  # of clipping causes
    relative_std: RelativeStd | None = None  # of the noise; None: the same at all times
    _cache: dict[str, tuple[GapFill | None, FloatArray]] = field(default_factory=dict)

    def derivative_spectra(self, fill: GapFill | None = None) -> FloatArray:
        """Return the DCT of the global derivatives, (7 + 3 g' + 3 k, n); cached.

        Args:
            fill: of the missing rows; None: they are zero.
        """
        if not self._has_cached("everywhere", fill):
            rows = [self.rate.T, np.ones((1, self.used.size)), -self.columns.time_derivative]
            rows += list(self.columns.shared)
            rows += [column.T for column in self.cause_derivatives]
            self._cache["everywhere"] = fill, self.spectra_of(np.concatenate(rows), fill)
        return self._cache["everywhere"][1]

    def _has_cached(self, name: str, fill: GapFill | None) -> bool:
        return name in self._cache and self._cache[name][0] is fill

    def spectra_of(self, signals: FloatArray, fill: GapFill | None) -> FloatArray:
        """Return the DCT of signals (..., n) with their missing rows filled."""
        masked = signals * self.used.astype(np.float64)
        return orthonormal_dct(masked if fill is None else fill.fill(masked))

    def base_derivatives(self, gain: FloatArray) -> FloatArray:
        """Return the derivatives by G, b and tau, sensor frame, (13, n, 3).

        Args:
            gain: G, shape (3, 3).
        """
        derivatives = np.zeros((BASE_PARAMETERS, self.used.size, 3))
        for axis in range(3):
            derivatives[3 * axis : 3 * axis + 3, :, axis] = self.rate.T
            derivatives[9 + axis, :, axis] = 1.0
        derivatives[12] = -(gain @ self.columns.time_derivative).T
        if self.pass_through is not None:
            for axis in range(3):
                derivatives[3 * axis : 3 * axis + 3, :, axis] += self.pass_through.gain_derivative[
                    axis
                ]
            derivatives[9:12] *= self.pass_through.after_threshold
            derivatives[12] *= self.pass_through.before_threshold
        return derivatives

    def shared_derivatives(self, gain: FloatArray) -> FloatArray:
        """Return the derivatives by the reference's shared unknowns, sensor frame, (g, n, 3)."""
        derivatives: FloatArray = np.einsum("ij,gjn->gni", gain, self.columns.shared)
        return (
            derivatives
            if self.pass_through is None
            else derivatives * self.pass_through.before_threshold
        )

    def packed_spectra_at(self, gain: FloatArray, fill: GapFill | None = None) -> FloatArray:
        """Return the DCT of the packed rows, sensor frame, (3, rows, n).

        Args:
            gain: G, shape (3, 3).
            fill: of the missing rows; None: they are zero.
        """
        if self.pass_through is None:
            return np.tensordot(gain, self.packed_spectra(fill), axes=1)
        signals = np.tensordot(gain, self.columns.packed.values.transpose(1, 0, 2), axes=1)
        return self.spectra_of(signals * self.pass_through.before_threshold.T[:, None, :], fill)

    def packed_spectra(self, fill: GapFill | None = None) -> FloatArray:
        """Return the DCT of the packed rows, stage frame, (3, rows, n); cached."""
        if not self._has_cached("packed", fill):
            signals = self.columns.packed.values.transpose(1, 0, 2)
            self._cache["packed"] = fill, self.spectra_of(signals, fill)
        return self._cache["packed"][1]


@dataclass(frozen=True, slots=True, eq=False)
class WhitenedPart:
    """The whitened derivatives of a part over (G, b, tau, terms, shared), and the local ones.

    Each axis has columns for its row of G (3), its bias, tau, the terms and the shared unknowns:
    see `parameter_index`.
    """

    columns: FloatArray  # (3, q, n), spectra
    packed: PackedColumns
    packed_signals: FloatArray  # (3, rows, n)
    std: FloatArray  # (n, 3), of each coefficient
    relative_std: RelativeStd | None = None
    gap_fill: GapFill | None = None  # of the missing rows; None: they are zero

    @classmethod
    def of(cls, part: PartModel, gain: FloatArray, noise: NoiseModel) -> Self:
        """Whiten a part.

        Args:
            part: its derivatives at the stage.
            gain: G, shape (3, 3), which transforms them to the sensor.
            noise: density of the residual.
        """
        n = part.used.size
        std = np.sqrt(noise.dct_variance(n))
        fill = gap_fill(part.used, noise)
        spectra, packed = part.derivative_spectra(fill), part.columns.packed
        shared_count = part.columns.shared.shape[0]
        columns = np.stack(
            [
                _axis_columns(spectra, gain[axis], axis, shared_count) / std[:, axis]
                for axis in range(3)
            ]
            if part.pass_through is None
            else [_clipped_axis_columns(part, gain, axis, fill) / std[:, axis] for axis in range(3)]
        )
        packed_signals = np.zeros((3, packed.values.shape[0], n))
        if packed.count:
            packed_signals = idct(
                part.packed_spectra_at(gain, fill) / std.T[:, None, :], axis=-1, norm="ortho"
            )
        relative_std = part.relative_std
        if relative_std is not None:
            columns = np.stack([relative_std.divide_spectra(columns[k], k) for k in range(3)])
            packed_signals = relative_std.divide_local(packed_signals)
        packed_signals = np.asarray(packed_signals, dtype=np.float64)
        return cls(columns, packed, packed_signals, std, relative_std, fill)

    def parameter_index(self, axis: int) -> IntArray:
        """Return the parameters of an axis' columns."""
        base = [3 * axis, 3 * axis + 1, 3 * axis + 2, 9 + axis, 12]
        return np.array([*base, *range(BASE_PARAMETERS, self.size)], dtype=np.int64)

    @property
    def size(self) -> int:
        """The number of parameters without the local ones."""
        return int(self.columns.shape[1]) - 5 + BASE_PARAMETERS

    def whiten(self, residual: FloatArray) -> FloatArray:
        """Return the whitened spectrum of a residual (n, 3), zero where unused, shape (3, n)."""
        signals = np.ascontiguousarray(residual.T)
        if self.gap_fill is not None:
            signals = self.gap_fill.fill(signals)
        spectrum = orthonormal_dct(signals) / self.std.T
        return spectrum if self.relative_std is None else self.relative_std.divide_spectra(spectrum)

    def local_score(self, white_spectrum: FloatArray) -> FloatArray:
        """Return the score of each local column for a whitened spectrum (3, n)."""
        if not self.packed.count:
            return np.zeros(0)
        signal = np.asarray(idct(white_spectrum, axis=-1, norm="ortho"), dtype=np.float64)
        total = np.zeros((self.packed_signals.shape[1], self.packed_signals.shape[2] + 1))
        np.cumsum(np.einsum("iln,in->ln", self.packed_signals, signal), axis=1, out=total[:, 1:])
        packed = self.packed
        part = total[packed.row, packed.stop_interval] - total[packed.row, packed.first_interval]
        return np.asarray(part * packed.scale, dtype=np.float64)


def _axis_columns(
    stage_spectra: FloatArray, gain_row: FloatArray, axis: int, shared_count: int
) -> FloatArray:
    """Return the columns of one axis: rate (3), bias, tau, terms, shared."""
    n = stage_spectra.shape[1]
    first_term = 7 + 3 * shared_count
    terms = stage_spectra[first_term + axis :: 3]
    columns = np.empty((5 + terms.shape[0] + shared_count, n))
    columns[:4] = stage_spectra[:4]
    columns[4] = gain_row @ stage_spectra[4:7]
    columns[5 : 5 + terms.shape[0]] = terms
    columns[5 + terms.shape[0] :] = np.einsum(
        "a,gan->gn", gain_row, stage_spectra[7:first_term].reshape(shared_count, 3, n)
    )
    return columns


def _clipped_axis_columns(
    part: PartModel, gain: FloatArray, axis: int, fill: GapFill | None
) -> FloatArray:
    """Return the same as `_axis_columns`, of the rates that pass the clipping causes."""
    base = part.base_derivatives(gain)[
        [3 * axis, 3 * axis + 1, 3 * axis + 2, 9 + axis, 12], :, axis
    ]
    rows = np.concatenate(
        [base, part.cause_derivatives[:, :, axis], part.shared_derivatives(gain)[:, :, axis]]
    )
    return part.spectra_of(rows, fill)


def whiten_residual(
    residuals: Sequence[FloatArray],
    noise: NoiseModel,
    relative_stds: Sequence[RelativeStd | None] = (),
    used: Sequence[BoolArray] | None = None,
) -> FloatArray:
    """Return a series' residual in units of its standard deviation, white, shape (n, 3).

    Args:
        residuals: of its parts, zero where unused, shape (n_p, 3) each.
        noise: its density.
        relative_stds: of each part's noise; None if it is the same at all times.
        used: which rows of each part are used; None: all.
    """
    whitened_parts = []
    for k, residual in enumerate(residuals):
        fill = None if used is None else gap_fill(used[k], noise)
        signals = residual.T if fill is None else fill.fill(residual.T)
        spectrum = orthonormal_dct(signals) / np.sqrt(noise.dct_variance(residual.shape[0]).T)
        relative_std = relative_stds[k] if relative_stds else None
        if relative_std is not None:
            spectrum = relative_std.divide_spectra(spectrum)
        whitened_parts.append(idct(spectrum, axis=-1, norm="ortho").T)
    return np.asarray(np.concatenate(whitened_parts), np.float64)
