"""Whether reference attitudes repeat the noise of the gyro, because they were computed from it.

Attitudes of another instrument have other noise, so that the residual is at least as large as the
noise of the gyro. If attitudes are the integral of the gyro's own rates, the residual is far
smaller at every frequency. A fit to them gives a gain of one and a bias of zero for every gyro.

What to use when: `shared_noise_reasons` after a fit to reference attitudes.
"""

from collections.abc import Sequence

import numpy as np
from scipy.fft import dct

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.attitude.attitude_solver import AttitudeSolver

CHUNK = 64  # coefficients of a mean power
MIN_CHUNKS = 4
MAX_RESIDUAL_SHARE = 0.1  # of the power; without shared noise the share is at least 1
# The quietest chunk may have this much of the power of white noise. With more, a motion can hide
# the noise, and a residual that is smaller than the motion shows nothing.
MAX_QUIET_RATIO = 4.0
MAX_FLOOR_SAMPLES = 1 << 17  # for the floor of the noise
SHARED_NOISE = (
    "the reference attitudes repeat the noise of the gyroscope, so they were computed from its "
    "rates and do not show its errors: the values are those of the attitudes' computation. Use "
    "attitudes of another instrument"
)


def shared_noise_reasons(solver: AttitudeSolver, samples: Sequence[GyroSamples]) -> tuple[str, ...]:
    """Return the reason to refuse a calibration if the attitudes were computed from the gyro.

    Args:
        solver: of the converged fit.
        samples: of each recording.
    """
    lengths = [segment.track.begin_s.size for segment in solver.segments]
    longest = int(np.argmax(lengths))
    if lengths[longest] // 2 <= MIN_CHUNKS * CHUNK:
        return ()
    recording = samples[solver.recording_of_segment[longest]]
    cleaned = solver.clean_segment(longest)
    gyro, residual = _chunk_powers(cleaned.measured), _chunk_powers(cleaned.residual)
    period_share = recording.period_s / solver.segments[longest].track.step_s
    white = _noise_floor(recording) * min(period_share, 1.0)
    is_quiet = gyro.min(axis=0) < MAX_QUIET_RATIO * white
    is_repeated = np.max(residual / np.maximum(gyro, 1e-30), axis=0) < MAX_RESIDUAL_SHARE
    return (SHARED_NOISE,) if np.all(is_quiet & is_repeated) else ()


def _chunk_powers(series: FloatArray) -> FloatArray:
    """Return the mean power of chunks of frequencies, (chunks, 3), without the constant.

    Only the lower half of the frequencies is used: in the upper half, the mean of a gyro over a
    step depends on the interpolation between its samples.
    """
    power = dct(series, axis=0, norm="ortho")[1 : len(series) // 2] ** 2
    return _means_of_chunks(power)


def _means_of_chunks(power: FloatArray) -> FloatArray:
    count = len(power) // CHUNK
    return np.asarray(power[: count * CHUNK].reshape(count, CHUNK, 3).mean(axis=1), np.float64)


def _noise_floor(samples: GyroSamples) -> FloatArray:
    """Return the variance of a sample's white noise, (3,): the lowest mean power of a chunk.

    A vibration does not increase it unless it is at all frequencies. A low-pass makes it too small,
    so that fewer attitudes are found to be computed.
    """
    stretches = samples.contiguous_slices(1)
    longest = max(stretches, key=lambda rows: rows.stop - rows.start)
    rows = slice(longest.start, min(longest.stop, longest.start + MAX_FLOOR_SAMPLES))
    power = dct(samples.gyro.values(rows), axis=0, norm="ortho")[1:] ** 2
    if len(power) < CHUNK:
        return np.zeros(3)
    return np.asarray(_means_of_chunks(power).min(axis=0), dtype=np.float64)
