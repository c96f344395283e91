"""The levels of the noise processes, fitted to the spectrum of a residual.

What to use when: `fit_noise_levels` for all axes; `fit_axis_levels` for chosen processes of one.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, Sampling, quantum_density
from gyrorig_solver.estimate.noise.residual_spectrum import Spectrum

# Priors of the levels' logarithms, and limits of Fisher scoring.
WHITE_PRIOR_LOG_STD, PRIOR_LOG_STD = 10.0, 3.0
LEVEL_ITERATIONS = 50
LEVEL_TOLERANCE = 1e-3
MAX_LOG_STEP, MAX_LOG_LEVEL = 3.0, 30.0


def fit_noise_levels(
    spectrum: Spectrum, sampling: Sampling, initial_levels: FloatArray | None = None
) -> NoiseModel:
    """Estimate the levels by Whittle's likelihood: sum of count x (log S + P/S)/2 per bin.

    Weak log-normal priors (a factor of e^3) keep processes that a short recording does not show
    near their usual levels, so that no level becomes zero or infinite.

    Args:
        spectrum: of the residual.
        sampling: of the residual.
        initial_levels: (3, 4), from a previous fit.
    """
    *processes, flat = spectrum.unit_densities(sampling)
    unit_density = np.array(processes)
    quantum = quantum_density(sampling)
    active = np.flatnonzero(unit_density.max(axis=1) > 0.0)
    levels = np.zeros((3, 4))
    upper_half = spectrum.frequency_hz > np.median(spectrum.frequency_hz)
    for axis in range(3):
        power = spectrum.density[:, axis]
        axis_unit_density = unit_density
        if spectrum.white_power is not None:
            axis_unit_density = unit_density.copy()
            axis_unit_density[0] *= spectrum.white_power[:, axis]
        white = float(
            np.median(power[upper_half] / np.maximum(axis_unit_density[0][upper_half], 1e-6))
        )
        nominal = nominal_levels(max(white, quantum * 1e-3, 1e-30))
        start = (
            nominal if initial_levels is None else np.maximum(initial_levels[axis], nominal * 1e-12)
        )
        axis_levels = fit_axis_levels(
            power,
            spectrum.count,
            axis_unit_density[active],
            quantum * flat,
            nominal[active],
            start[active],
        )
        levels[axis, active] = axis_levels
    return NoiseModel(levels, sampling)


def nominal_levels(white: float) -> FloatArray:
    """Return N^2, B^2, K^2, D^2 of an ordinary MEMS part with that N^2, shape (4,).

    The processes equal the white noise (L3G4200D: 0.03 dps/sqrt(Hz), 4 mdps, 0.3 mdps/sqrt(s)) at
    0.01 Hz for flicker, at 0.003 Hz for the random walk, and at 30 Hz for a differentiated
    attitude.
    """
    return white * np.array(
        [1.0, np.pi * 0.01, (2 * np.pi * 0.003) ** 2 / 2.0, (2 * np.pi * 30.0) ** -2]
    )


def fit_axis_levels(
    power: FloatArray,
    count: FloatArray,
    unit_density: FloatArray,
    quantum: FloatArray,
    nominal: FloatArray,
    start: FloatArray,
) -> FloatArray:
    """Return the levels of one axis by Fisher scoring in their logarithms.

    Args:
        power: density in each bin, shape (k,).
        count: coefficients in each bin, shape (k,).
        unit_density: of the active processes, shape (a, k).
        quantum: density of the quantisation error in each bin, shape (k,).
        nominal: centre of the priors, shape (a,).
        start: initial levels, shape (a,).
    """
    prior_log_std = np.where(np.arange(nominal.size) == 0, WHITE_PRIOR_LOG_STD, PRIOR_LOG_STD)

    def cost(x: FloatArray) -> float:
        total = (nominal * np.exp(x)) @ unit_density + quantum
        return 0.5 * float(
            count @ (np.log(total) + power / total) + np.sum((x / prior_log_std) ** 2)
        )

    x = np.clip(np.log(start / nominal), -MAX_LOG_LEVEL, MAX_LOG_LEVEL)
    current_cost = cost(x)
    for _ in range(LEVEL_ITERATIONS):
        contributions = (nominal * np.exp(x))[:, None] * unit_density
        total = contributions.sum(axis=0) + quantum
        gradient = (
            0.5 * (contributions @ (count * (total - power) / total**2)) + x / prior_log_std**2
        )
        hessian = 0.5 * (contributions * (count / total**2)) @ contributions.T + np.diag(
            prior_log_std**-2.0
        )
        step = np.clip(-np.linalg.solve(hessian, gradient), -MAX_LOG_STEP, MAX_LOG_STEP)
        new_cost = cost(x + step)
        while new_cost > current_cost and np.abs(step).max() > LEVEL_TOLERANCE:
            step = step / 2.0
            new_cost = cost(x + step)
        x, current_cost = np.clip(x + step, -MAX_LOG_LEVEL, MAX_LOG_LEVEL), new_cost
        if np.abs(step).max() < LEVEL_TOLERANCE:
            break
    return np.asarray(nominal * np.exp(x), dtype=np.float64)
