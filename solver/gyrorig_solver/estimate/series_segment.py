"""The state of one series of one recording at a fit, and whitening of signals on it.

What to use when: `SeriesSegment.whiten` for signals in units of the noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import dct, idct

from gyrorig_solver.data import BoolArray, FloatArray, IntArray, RealArray
from gyrorig_solver.estimate.linear.gap_fill import GapFill, gap_fill
from gyrorig_solver.estimate.linear.whitening import PartModel
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, dct_frequencies_hz
from gyrorig_solver.estimate.noise.relative_std import mean_white_power
from gyrorig_solver.estimate.whitened_signals import ChannelRows
from gyrorig_solver.model import AxisBiases, Signals, SignalState

ROWS_PER_BATCH = 4  # number of rows that fit into a cache
SAMPLES_LOOKED_AT = 64  # number of samples that are tested for a value other than zero


@dataclass(frozen=True, eq=False)
class SeriesSegment:
    """One series of one recording, with the state of its parts at a fit."""

    session_index: int
    used: tuple[BoolArray, ...]  # of each part
    states: tuple[SignalState, ...]
    exact_states: tuple[SignalState, ...]  # the same on the grid of the samples
    models: tuple[PartModel, ...]
    residuals: tuple[FloatArray, ...]  # (n, 3) each
    noise: NoiseModel

    def whiten(self, parts: Sequence[Signals]) -> tuple[ChannelRows, ...]:
        """Return signals (k, n, 3) of each part in units of the noise, by part and axis."""
        whitener = SignalWhitener(self, len(parts[0]))
        whitener.add(parts)
        return whitener.finish()

    def whiten_spectra(
        self, axis: int, spectra: Sequence[RealArray], parts: Sequence[RealArray]
    ) -> None:
        """Write signals of one axis, from their DCT, (r, n) of each part, in units of the noise."""
        constants = np.stack([spectrum[:, 0] for spectrum in spectra], axis=-1)
        for spectrum, weight, rows in zip(
            spectra, self._weights[parts[0].dtype.type], parts, strict=True
        ):
            np.multiply(spectrum, weight[axis], out=rows)
        if len(parts) > 1:
            # The parts of a long series share its lowest frequencies; see `normal_equations`.
            blocks = sum(used.size for used in self.used)
            rate_hz = self.noise.sampling.rate_hz
            density = self.noise.density_with(
                dct_frequencies_hz(blocks, rate_hz)[: len(parts)],
                mean_white_power([model.relative_std for model in self.models]),
            )
            scaled_constants = dct(constants, axis=-1, norm="ortho")
            scaled_constants /= np.sqrt(density[:, axis] * rate_hz / 2.0)
            for k, rows in enumerate(parts):
                rows[:, 0] = scaled_constants[:, k]
        for rows, model in zip(parts, self.models, strict=True):
            white = idct(rows, axis=-1, norm="ortho", overwrite_x=True)
            if model.relative_std is not None:
                white = model.relative_std.divide_signals(white, axis)
            if not np.may_share_memory(white, rows):
                rows[...] = white

    @cached_property
    def unused(self) -> tuple[IntArray, ...]:
        """The blocks of each part that are not used."""
        return tuple(np.flatnonzero(~used) for used in self.used)

    @cached_property
    def gap_fills(self) -> tuple[GapFill | None, ...]:
        """The prediction of the blocks of each part that are not used."""
        return tuple(gap_fill(used, self.noise) for used in self.used)

    @cached_property
    def _weights(self) -> dict[type, list[RealArray]]:
        """One over the standard deviation of each part's coefficients, (3, n), by precision."""
        variances = [self.noise.dct_variance(used.size).T for used in self.used]
        weights = [np.ascontiguousarray(variance) ** -0.5 for variance in variances]
        return {
            precision: [weight.astype(precision, copy=False) for weight in weights]
            for precision in (np.float64, np.float32)
        }


class SignalWhitener:
    """Whitens signals of a segment that arrive in sequence, some rows at a time."""

    def __init__(
        self,
        segment: SeriesSegment,
        capacity: int,
        precision: type[np.float32] | type[np.float64] = np.float64,
    ) -> None:
        """Allocate memory for `capacity` signals."""
        self._segment, self._count = segment, 0
        self._rows: list[list[RealArray]] = [
            [np.empty((capacity, used.size), precision) for used in segment.used] for _ in range(3)
        ]
        self._index: list[list[int]] = [[], [], []]
        self._finished = [0, 0, 0]  # rows that are whitened

    def add(self, parts: Sequence[Signals]) -> None:
        """Add signals of each part."""
        biases = [part.rows for part in parts if isinstance(part, AxisBiases)]
        if biases:
            self._add_biases(biases)
        else:
            self._add_signals([part for part in parts if not isinstance(part, AxisBiases)])
        self._count += len(parts[0])

    def _add_signals(self, parts: Sequence[FloatArray]) -> None:
        acts = np.any(
            [
                _acting_axes(part, used)
                for part, used in zip(parts, self._segment.used, strict=True)
            ],
            axis=0,
        )
        for k, axis in np.argwhere(acts):
            row = len(self._index[axis])
            self._index[axis].append(self._count + int(k))
            for part, unused, rows in zip(
                parts, self._segment.unused, self._rows[axis], strict=True
            ):
                rows[row] = part[k, :, axis]
                rows[row, unused] = 0.0
            if row + 1 - self._finished[axis] == ROWS_PER_BATCH:
                self._whiten_rows(axis)

    def _add_biases(self, parts: Sequence[FloatArray]) -> None:
        """Add rows (k, n) of each part, each on every axis alone, with one DCT for all axes."""
        for first in range(0, len(parts[0]), ROWS_PER_BATCH):
            spectra = []
            for part, unused, fill in zip(
                parts, self._segment.unused, self._segment.gap_fills, strict=True
            ):
                rows = part[first : first + ROWS_PER_BATCH].astype(self._rows[0][0].dtype)
                rows[:, unused] = 0.0
                if fill is not None:
                    rows = fill.fill(rows)
                spectra.append(dct(rows, axis=-1, norm="ortho", overwrite_x=True))
            for axis in range(3):
                self._whiten_rows(axis)
                begin = len(self._index[axis])
                signals = 3 * np.arange(first, first + len(spectra[0])) + axis
                self._index[axis] += (self._count + signals).tolist()
                self._finished[axis] = len(self._index[axis])
                self._segment.whiten_spectra(
                    axis, spectra, [rows[begin : self._finished[axis]] for rows in self._rows[axis]]
                )

    def finish(self) -> tuple[ChannelRows, ...]:
        """Return all signals, by part and axis."""
        for axis in range(3):
            self._whiten_rows(axis)
        return tuple(
            ChannelRows(
                np.array(self._index[axis], np.int64), (rows[part][: len(self._index[axis])],)
            )
            for part in range(len(self._segment.used))
            for axis, rows in enumerate(self._rows)
        )

    def _whiten_rows(self, axis: int) -> None:
        batch = slice(self._finished[axis], len(self._index[axis]))
        if batch.start < batch.stop:
            parts = [rows[batch] for rows in self._rows[axis]]
            for rows, fill in zip(parts, self._segment.gap_fills, strict=True):
                if fill is not None:
                    rows[...] = fill.fill(rows)
            spectra = [dct(rows, axis=-1, norm="ortho", overwrite_x=True) for rows in parts]
            self._segment.whiten_spectra(axis, spectra, parts)
            self._finished[axis] = batch.stop


def _acting_axes(signals: FloatArray, used: BoolArray) -> BoolArray:
    """Return which axes of which signals (k, n, 3) are not zero everywhere, (k, 3)."""
    acts: BoolArray = np.asarray(
        signals[:, :: max(1, used.size // SAMPLES_LOOKED_AT)].any(axis=1), dtype=np.bool_
    )
    for k, axis in np.argwhere(~acts):
        signal = signals[k, :, axis]
        acts[k, axis] = bool(signal.any()) and bool(signal[used].any())
    return acts
