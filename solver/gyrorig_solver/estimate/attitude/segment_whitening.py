"""Whitening of the segments of a fit to reference attitudes.

The density of the noise is a smooth model times correction factors in bins, both from the residual.
The noise of a camera grows with the motion, so the local scatter weights each instant.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import dct, idct

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.attitude.attitude_solver import smooth_power
from gyrorig_solver.estimate.attitude.block_segments import BlockSegment
from gyrorig_solver.estimate.noise.noise_levels import fit_noise_levels
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, Sampling
from gyrorig_solver.estimate.noise.residual_spectrum import Periodogram, bin_spectrum

SCATTER_WINDOW_S, MIN_SCATTER_VALUES = (
    5.0,
    40,
)  # window of the local scatter, and its minimum length
MIN_SCATTER = 0.3  # relative to the mean; a smaller local scatter is random


@dataclass(frozen=True, slots=True, eq=False)
class SegmentWhitener:
    """Whitens one segment and equalises its local scatter."""

    std: FloatArray  # (kept, 3), of each coefficient
    scatter: FloatArray  # (kept,), of each instant, about 1

    def whiten(self, signals: FloatArray) -> FloatArray:
        """Return signals (k, blocks, 3) in units of the noise, (k, 3 kept)."""
        spectrum = dct(signals.transpose(0, 2, 1), axis=-1, norm="ortho")
        in_band = spectrum[:, :, : self.std.shape[0]] / self.std.T
        evened = idct(in_band, axis=-1, norm="ortho") / self.scatter
        return np.asarray(evened.reshape(signals.shape[0], -1), dtype=np.float64)

    def unwhiten(self, white_signal: FloatArray, block_count: int) -> FloatArray:
        """Return the rates, (blocks, 3), of a whitened signal (3 kept,) in its band."""
        scaled = white_signal.reshape(3, -1) * self.scatter
        return self._padded(dct(scaled, axis=-1, norm="ortho") * self.std.T, block_count)

    def weight(self, white_signal: FloatArray, block_count: int) -> FloatArray:
        """Return the rates whose product with a signal equals the whitened product."""
        scaled = white_signal.reshape(3, -1) / self.scatter
        return self._padded(dct(scaled, axis=-1, norm="ortho") / self.std.T, block_count)

    def _padded(self, spectrum: FloatArray, block_count: int) -> FloatArray:
        padded = np.zeros((3, block_count))
        padded[:, : spectrum.shape[1]] = spectrum
        return np.asarray(idct(padded, axis=-1, norm="ortho").T, dtype=np.float64)


def build_whiteners(
    segments: Sequence[BlockSegment], band_hz: float
) -> tuple[NoiseModel, list[SegmentWhitener]]:
    """Return the smooth noise model, and the whitener of each segment.

    Args:
        segments: of the fit.
        band_hz: of the fit; higher frequencies are left out.
    """
    step_s = float(np.median([np.median(np.diff(segment.time_s)) for segment in segments]))
    rate_hz = 1.0 / step_s
    sampling = Sampling(rate_hz, 1, None, 0.0, differentiated=True)
    periodograms = [
        Periodogram.of(segment.residual - segment.effect, rate_hz).band(0.0, band_hz)
        for segment in segments
    ]
    noise = fit_noise_levels(bin_spectrum(periodograms), sampling)
    power, smooth, frequency = [], [], []
    for segment in segments:
        # The constant of a series represents all frequencies below that of its first coefficient.
        f = (
            np.maximum(np.arange(segment.in_band_count), 0.5)
            * rate_hz
            / (2.0 * segment.block_count)
        )
        frequency.append(f)
        smooth.append(noise.density(f) * rate_hz / 2.0)
        power.append(
            dct(segment.residual - segment.effect, axis=0, norm="ortho")[: segment.in_band_count]
            ** 2
        )
    level = smooth_power(np.concatenate(power) / np.concatenate(smooth), np.concatenate(frequency))
    ends = np.cumsum([segment.in_band_count for segment in segments])[:-1]
    whiteners = []
    for segment, segment_level, nominal_level in zip(
        segments, np.split(level, ends), smooth, strict=True
    ):
        whitener = SegmentWhitener(
            np.sqrt(segment_level * nominal_level), np.ones(segment.in_band_count)
        )
        whiteners.append(_scale_by_scatter(segment, whitener))
    return noise, whiteners


def _scale_by_scatter(segment: BlockSegment, whitener: SegmentWhitener) -> SegmentWhitener:
    """Return a whitener with the local scatter of the residual as an additional weight."""
    white = whitener.whiten((segment.residual - segment.effect)[None]).reshape(3, -1)
    power = np.mean(white**2, axis=0)
    step_s = float(segment.time_s[-1] - segment.time_s[0]) / power.size
    width = max(round(SCATTER_WINDOW_S / step_s), MIN_SCATTER_VALUES // 3)
    scatter = np.sqrt(_running_mean(power, min(width, power.size)))
    return replace(whitener, scatter=np.maximum(scatter, MIN_SCATTER))


def _running_mean(values: FloatArray, width: int) -> FloatArray:
    """Return the centred running mean, (n,); the end values continue beyond the ends."""
    before = width // 2
    padded = np.pad(values, (before, width - 1 - before), mode="edge")
    total = np.concatenate([[0.0], np.cumsum(padded)])
    return np.asarray(np.maximum(total[width:] - total[:-width], 0.0) / width, dtype=np.float64)
