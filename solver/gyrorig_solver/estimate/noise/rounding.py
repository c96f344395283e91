"""The error of a bias by the rounding of samples to counts.

Rounding is white noise of q^2/12 only if the noise of the sensor moves the samples over several
counts. With less noise, the mean of the rounded samples at rest differs from the rate by a
constant, which no time averages out. Its amplitude is q/pi exp(-2 pi^2 (sigma/q)^2), the first term
of the Fourier series of the error. Source: B. Widrow and I. Kollar, "Quantization Noise",
Cambridge University Press, 2008.
"""

from dataclasses import replace

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, aliased_low_pass

LEAST_NOISE_COUNTS = 0.45  # standard deviation of a sample, above which the error is below 1 %
FREQUENCIES = 512


def bias_std_by_rounding(noise: NoiseModel) -> FloatArray:
    """Return the standard uncertainty of the bias that rounding adds, rad/s, shape (3,).

    A fitted level cannot be below the rounding noise, so that it does not show how much less noise
    there is. The uncertainty is therefore that of an unknown position within a count, q/sqrt(12).
    """
    quantum_rad_s = noise.sampling.quantum_rad_s
    return np.where(is_rounded_without_dither(noise), quantum_rad_s / np.sqrt(12.0), 0.0)


def is_rounded_without_dither(noise: NoiseModel) -> BoolArray:
    """Return whether each axis has too little noise for the rounding to average out, (3,)."""
    sampling = noise.sampling
    raw_hz = sampling.rate_hz * sampling.samples_per_block
    raw = replace(sampling, rate_hz=raw_hz, samples_per_block=1)
    frequency_hz = np.linspace(0.0, raw_hz / 2.0, FREQUENCIES)
    power = noise.levels[:, 0] * float(aliased_low_pass(frequency_hz, raw).mean()) * raw_hz / 2.0
    return np.asarray(np.sqrt(power) < LEAST_NOISE_COUNTS * sampling.quantum_rad_s)
