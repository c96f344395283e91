"""A noise floor that arises after the sensor's low-pass.

The electronics after the low-pass add noise that is equal at all frequencies, like quantisation.
Above the cut-off, it can be larger than the noise that passed the filter. Without it in the model,
the residual has too much power there. The search would then name a spectral line, jitter of the
samples or noise of the motors. A recording has a floor in its model only if

 * the likelihood of the spectra of all axes together increases by more than `MIN_GAIN_NATS`, and
 * each floor is smaller than the white noise in the pass band, and
 * the noise at rest does not contradict it. Jitter also adds noise at all frequencies, but only in
   motion. Third differences of successive samples weight the highest frequencies most.

What to use when: `add_noise_floor` for levels that were fitted without a floor.
"""

from dataclasses import replace

import numpy as np

from gyrorig_solver.estimate.noise.noise_levels import fit_axis_levels
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, quantum_density
from gyrorig_solver.estimate.noise.residual_spectrum import Spectrum
from gyrorig_solver.estimate.noise.rest_noise import MIN_PAIRS, RestDifferences

# Chi-square 16 for three sizes: one false floor in 900 recordings.
MIN_GAIN_NATS = 8.0
NOMINAL_SHARE = 0.05  # centre of the prior, relative to the white noise in the pass band
# Relative to the white noise in the pass band; a larger floor would mean another low-pass.
MAX_SHARE = 1.0
DIFFERENCE_ORDER = 3
# Variance of the logarithm of the power of third differences of white noise, times their number;
# from 4000 draws.
LOG_POWER_VARIANCE = 4.6
CONTRADICTION_SIGMA = 3.0


def add_noise_floor(
    noise: NoiseModel, spectrum: Spectrum, differences: RestDifferences
) -> NoiseModel:
    """Return the noise with a floor if the data show one, with the levels fitted again.

    Args:
        noise: fitted to the spectrum, without a floor.
        spectrum: of the residual.
        differences: at rest, of the order `DIFFERENCE_ORDER`.
    """
    if noise.sampling.bandwidth_hz is None or noise.sampling.differentiated:
        return noise
    fitted = noise
    for axis in range(3):
        fitted = _fit_with_floor(fitted, spectrum, axis)
    gain_nats = _log_likelihood(spectrum, fitted) - _log_likelihood(spectrum, noise)
    is_small = bool(np.all(fitted.floor <= MAX_SHARE * fitted.levels[:, 0]))
    if gain_nats < MIN_GAIN_NATS or not is_small or _is_contradicted(fitted, differences):
        return noise
    return fitted


def _is_contradicted(noise: NoiseModel, differences: RestDifferences) -> bool:
    """Return whether there is significantly less noise at rest than a model predicts."""
    if differences.count < MIN_PAIRS:
        return True
    measured = np.maximum(differences.power, 1e-300)
    log_ratio = np.log(measured / differences.predict_power(noise))
    std = np.sqrt(LOG_POWER_VARIANCE / differences.count)
    return bool(np.any(log_ratio < -CONTRADICTION_SIGMA * std))


def _fit_with_floor(noise: NoiseModel, spectrum: Spectrum, axis: int) -> NoiseModel:
    """Return the noise with the levels and the floor of one axis fitted together."""
    *white_and_slow, flat = spectrum.unit_densities(noise.sampling)
    unit_density = np.array(white_and_slow)
    if spectrum.white_power is not None:
        unit_density[0] *= spectrum.white_power[:, axis]
    active = np.flatnonzero(noise.levels[axis] > 0.0)
    start = np.append(noise.levels[axis, active], NOMINAL_SHARE * noise.levels[axis, 0])
    processes = np.vstack([unit_density[active], flat])
    fitted = fit_axis_levels(
        spectrum.density[:, axis],
        spectrum.count,
        processes,
        quantum_density(noise.sampling) * flat,
        start,
        start,
    )
    levels, floor = noise.levels.copy(), noise.floor.copy()
    levels[axis, active], floor[axis] = fitted[:-1], fitted[-1]
    return replace(noise, levels=levels, floor=floor)


def _log_likelihood(spectrum: Spectrum, noise: NoiseModel) -> float:
    """Return Whittle's log-likelihood of the spectra of all axes."""
    density = spectrum.expected_density(noise)
    misfit = np.log(density) + spectrum.density / density
    return -0.5 * float(np.sum(spectrum.count @ misfit))
