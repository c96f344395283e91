"""Noise levels of a fit to a motion, and remarks on them.

What to use when: `noise_levels` for the levels that a calibration states, `noise_remarks` for what
a user must know about them.
"""

from collections.abc import Mapping

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.gyro_fit import NoiseLevels
from gyrorig_solver.estimate.noise.rounding import is_rounded_without_dither


def noise_levels(solution: ConvergedFit) -> NoiseLevels:
    """Return the noise levels of the last recording, which a calibration states."""
    noise = solution.noises[-1]
    levels = np.sqrt(noise.levels)
    return NoiseLevels(
        angle_random_walk=levels[:, 0],
        bias_instability=levels[:, 1],
        rate_random_walk=levels[:, 2],
        source=solution.noise_sources[-1],
        white_by_motor_state={
            state: levels[:, 0] * ratio for state, ratio in _last_noise_ratios(solution).items()
        },
        noise_floor=np.sqrt(noise.floor) if noise.floor.any() else None,
    )


def _last_noise_ratios(solution: ConvergedFit) -> Mapping[str, FloatArray]:
    """Return the noise in motion relative to that at rest, of the last recording that shows it."""
    ratios = (session.noise_ratios() for session in reversed(solution.sessions))
    return next((ratio for ratio in ratios if ratio), {})


def noise_remarks(solution: ConvergedFit, chi2_factor: float) -> list[str]:
    """Return remarks about noise in motion, jitter, and a multiplied covariance."""
    remarks = []
    ratio = _last_noise_ratios(solution).get("in_motion")
    rounded = np.any([is_rounded_without_dither(noise) for noise in solution.noises], axis=0)
    if rounded.any():
        axes = ", ".join(np.array(list("xyz"))[rounded].tolist())
        remarks.append(
            f"the noise of the samples (axis {axes}) is less than half a count. The noise levels "
            "are those of the rounding, and the bias has the uncertainty of a count. Select a "
            "smaller full scale"
        )
    elif ratio is not None:
        remarks.append(
            "the noise in motion is "
            + ", ".join(f"{value:.2f}" for value in ratio)
            + " times the noise at rest (x, y, z). The fit accounts for this. The usual cause is "
            "vibration of the motors"
        )
    if any(session.jitter_noise is not None for session in solution.sessions):
        remarks.append(
            "the noise is larger while the stage accelerates, on all axes in proportion to the "
            "acceleration. The fit accounts for this. The usual cause is jitter of the sample times"
        )
    if chi2_factor > 1.0:
        remarks.append(
            f"the solver multiplied the standard uncertainties by {np.sqrt(chi2_factor):.2f}, "
            f"because the residual variance in motion is {chi2_factor:.2f} times that of the noise "
            "model"
        )
    return remarks
