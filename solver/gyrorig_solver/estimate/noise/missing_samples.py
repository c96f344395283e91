"""The spectrum that noise has if samples are missing.

A missing sample of a series with single samples is a zero of the residual. The zeros spread the
power of each frequency over all frequencies. A block mean over fewer samples has more noise. In
both cases, the expected power at a frequency is the spectrum of the complete samples, convolved
with that of the mask of the used samples. A fit of the levels with these expected powers gives the
levels of complete samples. A fit with the spectrum of complete samples would give a wrong white
noise, and a noise floor that does not exist.

What to use when: `expected_densities` for the spectrum of a residual; `incomplete_densities` for
the noise that blocks with missing samples add.

Source: A. Sykulski, S. Olhede, A. Guillaumin, J. Lilly, J. Early, "The debiased Whittle
likelihood", Biometrika 106 (2019). The mask is reflected at both ends, as in a DCT.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.fft import irfft, rfft

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.noise.noise_model import PROCESSES, Sampling, process_densities


def has_gaps(used: BoolArray) -> bool:
    """Return whether values are missing between the first and the last used one.

    Nearly every recording of a unit begins and ends with some samples without a reference. They
    are no gap: they are few, and the residual is zero there.

    Args:
        used: which values are used, in order of time, any shape.
    """
    places = np.flatnonzero(used)
    return bool(places.size and places[-1] - places[0] + 1 > places.size)


def expected_densities(used_samples: BoolArray, sampling: Sampling) -> FloatArray | None:
    """Return the expected density of a residual by each process at unit level, (5, n - 1).

    The residual is zero in blocks without samples, and its power is divided by the share of the
    other blocks. The last process has the same density at all frequencies without missing samples.

    Args:
        used_samples: which samples of each block are used, (n, m).
        sampling: of the blocks.

    Returns:
        The densities at the frequencies of the DCT of the blocks without the constant; None if
        there are no gaps.
    """
    if used_samples.shape[0] < 2 or not has_gaps(used_samples):
        return None
    return _cached_densities(used_samples.tobytes(), used_samples.shape[1], sampling)


def incomplete_densities(used_samples: BoolArray, sampling: Sampling) -> FloatArray:
    """Return the density that blocks with missing samples add to that of complete blocks, (5,).

    Args:
        used_samples: which samples of each block are used, (n, m).
        sampling: of the blocks.
    """
    m = used_samples.shape[1]
    weights = _block_weights(used_samples[used_samples.any(axis=1)])
    if m == 1 or not has_gaps(used_samples):
        return np.zeros(PROCESSES)
    covariance = _unit_covariances(max(used_samples.shape[0], 2) * m, _of_samples(sampling, m))
    added = np.zeros(PROCESSES)
    for lag in range(m):
        products = float(np.mean(np.sum(weights[:, : m - lag] * weights[:, lag:], axis=1)))
        excess = products - (m - lag) / m**2
        added += (1.0 if lag == 0 else 2.0) * excess * covariance[:, lag]
    return np.asarray(added * 2.0 / sampling.rate_hz, dtype=np.float64)


def _of_samples(sampling: Sampling, samples_per_block: int) -> Sampling:
    """Return the sampling of the samples of which the blocks are means."""
    return replace(
        sampling,
        rate_hz=sampling.rate_hz * samples_per_block,
        samples_per_block=sampling.samples_per_block // samples_per_block,
    )


def _block_weights(used_samples: BoolArray) -> FloatArray:
    """Return the weight of each sample in the mean of its block, (n, m)."""
    counts = np.maximum(used_samples.sum(axis=1, keepdims=True), 1)
    return np.asarray(used_samples / counts, dtype=np.float64)


def _unit_covariances(count: int, sampling: Sampling) -> FloatArray:
    """Return the covariance of samples at each lag by each process at unit level, (5, count + 1).

    It belongs to a series that is reflected at both ends, and so has twice the length.
    """
    frequency_hz = np.linspace(0.0, sampling.rate_hz / 2.0, count + 1, dtype=np.float64)
    densities = process_densities(frequency_hz, sampling)
    covariances = irfft(densities * sampling.rate_hz / 2.0, 2 * count, axis=1)
    return np.asarray(covariances[:, : count + 1], dtype=np.float64)


@lru_cache(maxsize=32)
def _cached_densities(used_bytes: bytes, samples_per_block: int, sampling: Sampling) -> FloatArray:
    m = samples_per_block
    used_samples = np.frombuffer(used_bytes, dtype=np.bool_).reshape(-1, m)
    n = used_samples.shape[0]
    covariances = _unit_covariances(n * m, _of_samples(sampling, m))
    weights = _block_weights(used_samples)
    spectra = rfft(np.concatenate([weights, weights[::-1, ::-1]]), axis=0)  # (n + 1, m)
    total = np.zeros((PROCESSES, 2 * n))
    for offset in range(1 - m, m):
        first = max(0, -offset)
        stop = m - max(0, offset)
        pairs = np.sum(
            np.conj(spectra[:, first:stop]) * spectra[:, first + offset : stop + offset], axis=1
        )
        mask_correlation = irfft(pairs, 2 * n) / (2.0 * n)
        lag = np.abs(np.arange(2 * n) * m + offset)
        total += covariances[:, np.minimum(lag, 2 * n * m - lag)] * mask_correlation
    density = rfft(total, axis=1).real[:, 1:n] * (2.0 / sampling.rate_hz)
    density /= max(float(used_samples.any(axis=1).mean()), 1e-3)  # as in `Periodogram.of`
    density.flags.writeable = False
    return np.asarray(density, dtype=np.float64)
