"""Values of one board from its recordings, as a part of the twin.

What to use when: `measure_board` with the fit of `pipeline`.
"""

import math

import numpy as np

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.twin import Scalar, Source, TwinBoard, TwinClock, TwinTemperature, Vector
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.metadata_numbers import positive_number
from gyrorig_solver.data.samples import GyroSamples, mean_temperature_degc
from gyrorig_solver.estimate import (
    PRIOR_LOG_STD,
    PRIOR_STD,
    GyroFit,
    NoiseModel,
    Spectrum,
)
from gyrorig_solver.pipeline import BoardData, CriticisedFit
from gyrorig_solver.twin.joint_covariance import session_wander_rad_s
from gyrorig_solver.twin.quantities import matrix, scalar, vector

STATED_PROCESSES = (0, 1, 2, 4)  # of N, B, K, D and F: a gyroscope has no white angle noise
CRYSTAL_WALK_PER_SQRT_S = 1e-8  # of a crystal's rate (docs/clocks.md)
MAX_STAMPS = 2_000_000  # in a long recording, the first ones are sufficient
MIN_STAMPS = 100
# times the median deviation; with a larger deviation, the timestamp is late
MAX_STAMP_DEVIATIONS = 10.0
TEMPERATURE_POINTS = 200
MIN_TEMPERATURES = 2
MAX_RELATIVE_LEVEL_STD = 0.7  # with a larger one, a recording does not determine a level


def measure_board(data: BoardData, criticised: CriticisedFit) -> TwinBoard:
    """Return the values of one board from its fit and its samples.

    A field without a value is left out, so that it keeps the default of the emulator.

    Args:
        data: of the board. Bias and clock are those of the last recording.
        criticised: the fit of the board.
    """
    fit, samples, recording = criticised.fit, data.samples[-1], data.recordings[-1]
    gain_source: Source = "recording" if np.isfinite(fit.gain).any() else "default"
    is_known = np.isfinite(fit.gain)
    deviations = np.where(is_known, fit.gain_std, PRIOR_STD["gain"])
    stds = np.array([fit.std.get(f"bias.{axis}", math.nan) for axis in "xyz"])
    bias = vector(fit.bias_rad_s, np.hypot(stds, session_wander_rad_s(criticised)), "rad/s")
    white, flicker, walk, floor = _noise_levels(criticised)
    full_scale_dps = positive_number(samples.metadata, "gyro_full_scale_dps")
    stamp_jitter = _measure_stamp_jitter(recording, samples)
    return TwinBoard(
        gain=matrix(np.where(is_known, fit.gain, np.eye(3)), deviations, "1", gain_source),
        bias=bias or Vector((0.0, 0.0, 0.0), None, "rad/s", "default"),
        time_offset=_time_offset(fit, samples),
        noise_density=white,
        bias_instability=flicker,
        rate_random_walk=walk,
        noise_floor=floor,
        odr=_measure_odr(samples, stamp_jitter),
        bandwidth=_stated(samples.bandwidth_hz, "Hz"),
        full_scale=_stated(full_scale_dps and math.radians(full_scale_dps), "rad/s"),
        count=_stated(samples.quantum_rad_s, "rad/s"),
        clock=_measure_clock(samples),
        stamp_jitter=stamp_jitter,
        temperature=_temperature_curve(data, 0),
        later_temperatures={
            recording.path.name: curve
            for k, recording in enumerate(data.recordings)
            if k > 0 and (curve := _temperature_curve(data, k)) is not None
        },
        unexplained=_unexplained_effects(criticised),
    )


def _unexplained_effects(criticised: CriticisedFit) -> tuple[str, ...]:
    """Return the significant effects in the residual that no known cause explains."""
    explanation = criticised.explanation
    unexplained = None if explanation is None else explanation.findings.unexplained
    if unexplained is None:
        return ()
    return tuple(test.description for test in (unexplained.leading, *unexplained.others))


def _stated(value: float | None, unit: str) -> Scalar | None:
    """Return a setting that the recording states, without an uncertainty."""
    return None if value is None else scalar(value, None, unit)


def _time_offset(fit: GyroFit, samples: GyroSamples) -> Scalar:
    """Return the total lag of the samples, including the delay of the low-pass."""
    std_s = fit.std.get("time_offset", math.nan)
    offset = scalar(fit.time_offset_s, std_s, "s")
    bandwidth_hz = samples.bandwidth_hz
    # The delay at zero frequency of a second-order Butterworth.
    low_pass_s = 0.0 if bandwidth_hz is None else math.sqrt(0.5) / (math.pi * bandwidth_hz)
    return offset or Scalar(low_pass_s + samples.period_s / 2.0, None, "s", "default")


def _noise_levels(criticised: CriticisedFit) -> tuple[Vector | None, ...]:
    """Return white noise, flicker, random walk and, if present, the floor of the residual."""
    noise, solution = criticised.fit.noise, criticised.solution
    if noise is None:
        return (None,) * len(STATED_PROCESSES)
    white = noise.angle_random_walk
    if solution is not None:
        white = white * mean_white_factor(solution.spectra[-1])
    levels = (white, noise.bias_instability, noise.rate_random_walk, noise.noise_floor)
    units = ("rad/s/sqrt(Hz)", "rad/s", "rad/s/sqrt(s)", "rad/s/sqrt(Hz)")
    if solution is None:
        return tuple(
            None if values is None else vector(values, None, unit)
            for values, unit in zip(levels, units, strict=True)
        )
    relative = _relative_level_stds(solution.noises[-1], solution.spectra[-1])
    return tuple(
        None if values is None else _level(values, share, unit)
        for values, share, unit in zip(levels, relative.T, units, strict=True)
    )


def _level(values: FloatArray, relative: FloatArray, unit: str) -> Vector | None:
    """Return a noise level with its relative standard deviation, (3,) each."""
    is_shown = bool(relative.max() < MAX_RELATIVE_LEVEL_STD)
    return vector(values, values * relative, unit, "recording" if is_shown else "default")


def mean_white_factor(spectrum: Spectrum) -> FloatArray:
    """Return the white noise of a recording relative to that at rest, shape (3,).

    A fit can find more white noise in motion than at rest. The emulated rig always has the same
    noise, so it gets the mean of both.
    """
    if spectrum.white_power is None:
        return np.ones(3)
    power = np.average(spectrum.white_power, axis=0, weights=spectrum.count)
    return np.asarray(np.sqrt(power), dtype=np.float64)


def _relative_level_stds(noise: NoiseModel, spectrum: Spectrum) -> FloatArray:
    """Return the relative standard deviation of each level, shape (3, 4): axis, process.

    They are from the curvature of Whittle's likelihood (Whittle, "Estimation and information in
    stationary time series", 1953): the information about the logarithms of the levels is half the
    sum of the squared shares of the density.

    A value near that of the prior means that the spectrum does not show the process.

    Args:
        noise: the fitted levels.
        spectrum: the spectrum that they were fitted to.
    """
    unit_density = spectrum.unit_densities(noise.sampling)
    total = spectrum.expected_density(noise)
    stds = np.empty((3, len(STATED_PROCESSES)))
    for axis in range(3):
        levels = np.append(noise.levels[axis], noise.floor[axis])
        contributions = levels[:, None] * unit_density
        if spectrum.white_power is not None:
            contributions[0] *= spectrum.white_power[:, axis]
        shares = contributions / total[:, axis]
        active = np.flatnonzero(shares.max(axis=1) > 0.0)
        information = 0.5 * (shares[active] * spectrum.count) @ shares[active].T
        information += np.eye(active.size) * PRIOR_LOG_STD**-2
        # The levels are squares: the logarithm of an amplitude has half the standard deviation.
        log_stds = np.full(len(contributions), PRIOR_LOG_STD)
        log_stds[active] = np.sqrt(np.diag(np.linalg.inv(information)))
        stds[axis] = 0.5 * log_stds[list(STATED_PROCESSES)]
    return stds


def _measure_odr(samples: GyroSamples, stamp_jitter: Scalar | None) -> Scalar | None:
    span_s = float(samples.time_s[-1] - samples.time_s[0])
    if not (samples.period_s > 0.0 and span_s > 0.0):
        return None
    odr_hz = 1.0 / samples.period_s
    jitter_s = 0.0 if stamp_jitter is None else stamp_jitter.value
    ends = math.sqrt(2.0) * jitter_s / span_s  # error of the first and the last sample
    return scalar(odr_hz, odr_hz * math.hypot(_skew_std(samples, span_s), ends), "Hz")


def _measure_clock(samples: GyroSamples) -> TwinClock:
    """Return the clock of the board; imported samples have the clock of their times only."""
    tick_hz = positive_number(samples.metadata, "tick_hz")
    if tick_hz is None or samples.is_imported:
        return TwinClock()
    span_s = float(samples.time_s[-1] - samples.time_s[0])
    clock = samples.clock
    return TwinClock(
        skew=scalar(clock.skew_ppm * 1e-6, _skew_std(samples, span_s), "1"),
        wander=scalar(clock.walk_per_sqrt_s, None, "1/sqrt(s)"),
        tick_hz=tick_hz,
    )


def _skew_std(samples: GyroSamples, span_s: float) -> float:
    """Return the uncertainty of a clock's skew, from its mapping and from its wander."""
    sigma_s = samples.clock.sigma_s
    mapping = math.sqrt(2.0) * (sigma_s if math.isfinite(sigma_s) else 0.0) / span_s
    wander = samples.clock.walk_per_sqrt_s
    walk = (
        max(wander, CRYSTAL_WALK_PER_SQRT_S) if math.isfinite(wander) else CRYSTAL_WALK_PER_SQRT_S
    )
    return math.hypot(mapping, walk * math.sqrt(span_s))


def _measure_stamp_jitter(recording: Recording, samples: GyroSamples) -> Scalar | None:
    """Return the mean delay of a sample's timestamp, from the second differences of the ticks.

    An exponential delay has a standard deviation equal to its mean.
    """
    tick_hz = positive_number(samples.metadata, "tick_hz")
    if tick_hz is None or samples.is_imported:
        return None
    board = BoardId(samples.board)
    ticks = recording.imu_field(board, "device_time")[:MAX_STAMPS].astype(np.int64)
    numbers = recording.imu_field(board, "sequence")[:MAX_STAMPS].astype(np.int64)
    steps, consecutive = np.diff(ticks), np.diff(numbers) == 1
    usable = consecutive[1:] & consecutive[:-1] & (steps[1:] > 0) & (steps[:-1] > 0)
    changes = np.diff(steps)[usable].astype(np.float64)
    if changes.size < MIN_STAMPS:
        return None
    deviation = float(np.median(np.abs(changes)))
    inside = changes[np.abs(changes) <= MAX_STAMP_DEVIATIONS * max(deviation, 1.0)]
    # A second difference has six times the variance of a timestamp; rounding to ticks adds 1/12.
    variance = float(np.mean(inside**2)) / 6.0 - 1.0 / 12.0
    if variance <= 0.0:
        return scalar(0.0, 1.0 / tick_hz, "s")
    jitter_s = math.sqrt(variance) / tick_hz
    return scalar(jitter_s, jitter_s * math.sqrt(4.0 / inside.size), "s")


def _temperature_curve(data: BoardData, recording_index: int) -> TwinTemperature | None:
    """Return the temperatures of a recording as means over equal times."""
    samples = data.samples[recording_index]
    degc = samples.temperature_degc
    if degc is None:
        return None
    valid = np.isfinite(degc)
    if np.count_nonzero(valid) < MIN_TEMPERATURES:
        return None
    time_s, readings = samples.time_s[valid], degc[valid]
    points = min(TEMPERATURE_POINTS, readings.size // 2)
    cuts = np.linspace(0, readings.size, max(points, MIN_TEMPERATURES) + 1).astype(np.int64)
    means_s, means_degc = _means_between(time_s, cuts), _means_between(readings, cuts)
    increasing = np.concatenate([[True], np.diff(means_s) > 0.0])
    if np.count_nonzero(increasing) < MIN_TEMPERATURES:
        return None
    return TwinTemperature(
        time_s=tuple(np.round(means_s[increasing], 3).tolist()),
        degc=tuple(np.round(means_degc[increasing], 4).tolist()),
        reference_degc=mean_temperature_degc(data.samples),
    )


def _means_between(values: FloatArray, cuts: np.ndarray) -> FloatArray:
    return np.asarray(np.add.reduceat(values, cuts[:-1]) / np.diff(cuts), dtype=np.float64)
