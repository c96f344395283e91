"""Which parameters a motion can show, judged before any fit.

The reference motion and the sensor's noise are enough: the information that the samples
hold about gain, bias and time offset does not depend on the counts. The rank test is the
estimator's own, so the two cannot disagree about what it means to be observable.
"""

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.information import NAMES, white_information
from gyrorig_solver.estimate.observability import conclude, decide
from gyrorig_solver.estimate.result import Observability
from gyrorig_solver.reference.motion import ReferenceMotion
from gyrorig_solver.samples import GyroSamples

_GRID_HZ = 50.0  # motions of a unit change within tenths of a second
_MAX_POINTS = 200_000
_FEWEST_POINTS = 16


def capability(
    samples: GyroSamples, reference: ReferenceMotion, words: dict[str, str]
) -> Observability:
    """Return what a fit of these samples against this motion could show.

    Args:
        samples: of one board.
        reference: the stage's motion, on the samples' time axis.
        words: for each gain column, `bias` and `time_offset`, why it may be hidden.

    Raises:
        InputError: the motion is known nowhere in the recording.
    """
    rate, step_s = _stage_rate(samples, reference)
    density = np.array([_noise_density(samples, axis) for axis in range(3)])
    information = white_information(rate, step_s, density)
    estimate = np.concatenate([np.eye(3).ravel(), np.zeros(4)])
    return conclude(estimate, NAMES, decide(information, NAMES), words).observability


def _stage_rate(samples: GyroSamples, reference: ReferenceMotion) -> tuple[FloatArray, float]:
    """Return the known mean stage rates on a uniform grid, shape (n, 3), and its step."""
    start, end = float(samples.time_s.min()), float(samples.time_s.max())
    count = int(np.clip((end - start) * _GRID_HZ, 16, _MAX_POINTS))
    edges = np.linspace(start, end, count + 1)
    rate = reference.evaluate(edges).rate_rad_s
    known = np.isfinite(rate).all(axis=1)
    if known.sum() < _FEWEST_POINTS:
        raise InputError(
            f"the unit's motion is not known while board {samples.board} sampled",
            "look at the faults noted in the recording, and record again",
        )
    return rate[known], float(edges[1] - edges[0])


def _noise_density(samples: GyroSamples, axis: int) -> float:
    """Return the one-sided white noise density, (rad/s)^2/Hz, from neighbours' differences."""
    change = np.diff(samples.rate_rad_s[:, axis])
    middle = float(np.median(np.abs(change - np.median(change))))
    std = middle / 0.6745 / np.sqrt(2.0)  # a normal's median absolute deviation
    std = max(std, samples.quantum_rad_s / np.sqrt(12.0))
    return float(2.0 * std**2 * samples.period_s)
