"""Observability before a fit, from the motion and the noise of the samples.

The Fisher information of the samples about gain, bias and time offset follows from the reference
motion and the noise of the sensor. It does not depend on the counts. Its rank test is that of the
estimator.
"""

from collections.abc import Mapping

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.derived_parameters import derive_parameters
from gyrorig_solver.estimate.gyro_fit import ObservabilityReport
from gyrorig_solver.estimate.information import PARAMETER_NAMES, white_noise_information
from gyrorig_solver.estimate.observability import analyse_observability
from gyrorig_solver.estimate.typical_board import expected_estimate
from gyrorig_solver.reference import ReferenceMotion

_GRID_HZ = 50.0  # motions of a unit change within tenths of a second
_MAX_GRID_POINTS = 200_000
_MIN_GRID_POINTS = 16


def predict_observability(
    samples: GyroSamples, reference: ReferenceMotion, reasons: Mapping[str, str]
) -> ObservabilityReport:
    """Return the observability of a fit of these samples against this motion.

    Args:
        samples: of one board.
        reference: the stage's motion, on the samples' time axis.
        reasons: for each gain column, `bias` and `time_offset`, why it can be unobservable.

    Raises:
        InputError: the motion is not known during the samples.
    """
    rate, step_s = _stage_rate(samples, reference)
    density = np.array([_noise_density(samples, axis) for axis in range(3)])
    information = white_noise_information(rate, step_s, density)
    analysis = analyse_observability(information, PARAMETER_NAMES)
    return derive_parameters(
        expected_estimate(analysis), PARAMETER_NAMES, analysis, reasons
    ).observability


def _stage_rate(samples: GyroSamples, reference: ReferenceMotion) -> tuple[FloatArray, float]:
    """Return the known mean stage rates on a uniform grid, shape (n, 3), and its step."""
    start, end = float(samples.time_s.min()), float(samples.time_s.max())
    count = int(np.clip((end - start) * _GRID_HZ, 16, _MAX_GRID_POINTS))
    edges = np.linspace(start, end, count + 1)
    rate = reference.evaluate(edges).rate_rad_s
    known = np.isfinite(rate).all(axis=1)
    if known.sum() < _MIN_GRID_POINTS:
        raise InputError(
            "the recording does not contain the motion of the pan-tilt unit for the time in which "
            f"board {samples.board} sent samples",
            "read the faults of the recording with `gyrorig check`, correct them, and record again",
        )
    return rate[known], float(edges[1] - edges[0])


def _noise_density(samples: GyroSamples, axis: int) -> float:
    """Return the one-sided white noise density, (rad/s)^2/Hz, from first differences."""
    change = np.diff(samples.rate_rad_s[:, axis])
    middle = float(np.median(np.abs(change - np.median(change))))
    std = middle / 0.6745 / np.sqrt(2.0)  # from the median absolute deviation
    std = max(std, samples.quantum_rad_s / np.sqrt(12.0))
    return float(2.0 * std**2 * samples.period_s)
