"""Features of one recording that are compared between measurement and simulation.

A feature is a number that the same program computes from a measured and from a simulated recording,
for example the residual in one bin of the pan angle. Features of one kind are a family.

The residual is the measured rate minus the prediction of the best simulation. Its features are
regressions in bins of a covariate, weighted by the noise of the simulation.

What to use when: `session_features` for all families of a recording.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gyrorig_protocol.recording.recording import times_ns
from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate import Periodogram
from gyrorig_solver.twin_check.observed_session import AXES, ObservedSession
from gyrorig_solver.twin_check.predictive_density import RateDensity

ANGLE_BINS, TILT_BINS, RATE_BINS, TIME_BINS, EDGE_BINS = 16, 8, 12, 12, 10
EDGE_S = 0.5  # after the start or the end of a move
MIN_TEMPERATURE_SPAN_K = 0.5
MIN_BIN_BLOCKS = 12
MOVING_RAD_S = 0.003
ALLAN_S = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
SPECTRUM_BINS, LOWEST_HZ = 12, 0.03
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
STALL_FACTOR = 15.0  # times the usual excess; a later sample waited for a stall of the host
SAME_STALL_S = 0.02  # after a stall, all waiting frames arrive within this time
CLOCK_S = (1.0, 3.0, 10.0)  # time steps of the clock's innovation
SENSOR_AXES = "xyz"
FEW_LOST = 10  # a session that loses no more samples can follow one that loses none
ROBUST_STD = 1.4826  # standard deviation of a normal sample by its median absolute deviation


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """Features of one kind."""

    key: str
    title: str  # subject of the comparison, in plain words
    unit: str  # of the values as shown
    covariate: str  # label of the x-axis of a figure
    x: FloatArray  # (m,), covariate of each feature
    axis: tuple[str, ...]  # (m,), of the sensor or the unit; "" for neither
    values: FloatArray  # (m,)
    floor: float  # smallest meaningful scatter of a value
    is_of_rare_events: bool = False  # few in a session, so that its values are far from normal


def session_features(
    session: ObservedSession,
    density: RateDensity,
    residual_rad_s: FloatArray,
    offset_rad_s: FloatArray,
    limits: dict[str, tuple[float, float]],
) -> list[Family]:
    """Return all families of one recording.

    Args:
        session: the recording.
        density: the noise of the simulation, which weights the residual.
        residual_rad_s: measured minus predicted rate, shape (n, 3).
        offset_rad_s: the mean that was removed from it, shape (3,).
        limits: of the covariates; missing limits are added, so that all compared recordings have
            the same bins.
    """
    families = [
        _bias_family(offset_rad_s),
        *_residual_families(session, density, residual_rad_s, limits),
        *_noise_families(session, density.completed(residual_rad_s)),
        *_motion_families(session),
        *_latency_families(session),
        _lost_family(session),
        *_clock_families(session),
    ]
    return [family for family in families if family.values.size]


def _bias_family(offset_rad_s: FloatArray) -> Family:
    return Family("bias", "bias of the session", "deg/s", "axis x 0, y 1, z 2", np.arange(3.0),
                  tuple(SENSOR_AXES), np.degrees(offset_rad_s), 1e-7)  # fmt: skip


def _residual_families(
    session: ObservedSession,
    density: RateDensity,
    residual: FloatArray,
    limits: dict[str, tuple[float, float]],
) -> list[Family]:
    stage = session.stage_rate_rad_s
    pan_rate = _pan_rate(session)
    pan, tilt = np.degrees(session.angle_rad)
    n = session.block_count
    ones = np.ones((n, 3))
    predicted = session.rate_rad_s - residual
    bend = np.gradient(np.asarray(stage), 1.0 / session.sampling.rate_hz, axis=0)
    moving = np.abs(stage).max(axis=1) > MOVING_RAD_S
    time_s = session.block_time_s - session.block_time_s[0]
    in_motion = ones * moving[:, None]
    regress = _Regression(session, density, residual, limits)
    percent, deg = 100.0, float(np.degrees(1.0))
    families = [
        regress.family("time", "residual against the time since the start", "deg/s",
                       "time since the start, s", time_s, ones, TIME_BINS, deg),
        regress.family("rest", "residual at rest against the tilt angle", "deg/s", "tilt, deg",
                       np.where(moving, np.nan, tilt), ones, TILT_BINS, deg),
        regress.family("pan", "gain error against the pan angle", "%", "pan, deg", pan,
                       np.repeat(pan_rate[:, None], 3, axis=1), ANGLE_BINS, percent),
        regress.family("tilt", "gain error against the tilt angle", "%", "tilt, deg", tilt,
                       stage[:, :1] * ones, TILT_BINS, percent),
        regress.family("rate", "residual against the rate of the same axis", "deg/s",
                       "rate, deg/s", np.degrees(predicted), in_motion, RATE_BINS, deg),
        regress.family("acceleration", "residual against the acceleration of the stage", "deg/s",
                       "acceleration, deg/s²", np.degrees(bend[:, [0, 1, 2]]),
                       in_motion, RATE_BINS, deg),
    ]  # fmt: skip
    for name, since, sign in _edges(session):
        families.append(
            regress.family(
                name,
                f"residual after the {name.replace('_', ' of ')} moves",
                "deg/s",
                "time after the edge, ms",
                1e3 * since,
                sign[:, None] * ones,
                EDGE_BINS,
                deg,
            )
        )
    temperature = _known_temperature(session)
    if temperature is not None and np.ptp(temperature[1]) > MIN_TEMPERATURE_SPAN_K:
        at_blocks = np.interp(session.block_time_s, *temperature)
        families.append(
            regress.family("temperature", "residual against the temperature", "deg/s",
                           "temperature, °C", at_blocks, ones, TIME_BINS, deg)
        )  # fmt: skip
    return families


def _known_temperature(session: ObservedSession) -> tuple[FloatArray, FloatArray] | None:
    """Return times, s, and temperatures, degC, of the samples that have one; None without them."""
    degc = session.samples.temperature_degc
    if degc is None:
        return None
    is_known = np.isfinite(degc)
    return (session.samples.time_s[is_known], degc[is_known]) if is_known.any() else None


@dataclass(frozen=True, slots=True, eq=False)
class _Regression:
    """Regressions of a residual in bins, weighted by the noise."""

    session: ObservedSession
    density: RateDensity
    residual: FloatArray
    limits: dict[str, tuple[float, float]]

    def family(
        self,
        key: str,
        title: str,
        unit: str,
        label: str,
        covariate: FloatArray,
        regressor: FloatArray,
        bins: int,
        factor: float,
    ) -> Family:
        """Return the slope of the residual by a regressor in each bin and for each axis.

        Args:
            key: of the family.
            title: of the family.
            unit: of the values times `factor`.
            label: of the covariate.
            covariate: shape (n,) or (n, 3); nan where unused.
            regressor: shape (n, 3).
            bins: number of bins, from the smallest to the largest value.
            factor: of the slopes.
        """
        covariates = covariate if covariate.ndim == 2 else np.repeat(covariate[:, None], 3, axis=1)
        white = self.density.white_spectrum(self.residual)
        x, axes, values = [], [], []
        for axis in range(3):
            position = covariates[:, axis]
            known = np.isfinite(position) & (regressor[:, axis] != 0.0) & self.session.used
            if known.sum() < MIN_BIN_BLOCKS:
                continue
            name = f"{key}.{axis}"
            if name not in self.limits:
                low, high = np.quantile(position[known], (0.002, 0.998)).tolist()
                self.limits[name] = (low, high + 1e-9)
            low, high = self.limits[name]
            if high - low < 1e-6:
                continue
            index = np.floor((position - low) / (high - low) * bins)
            for row in range(bins):
                inside: BoolArray = known & (index == row)
                x.append(low + (row + 0.5) * (high - low) / bins)
                axes.append(SENSOR_AXES[axis])
                values.append(np.nan)
                if inside.sum() >= MIN_BIN_BLOCKS:
                    signal = np.where(inside, regressor[:, axis], 0.0)
                    column = self.density.white_column(signal, axis)
                    values[-1] = factor * float(column @ white[axis]) / float(column @ column)
        return Family(key, title, unit, label, np.array(x), tuple(axes), np.array(values), 1e-7)


def _pan_rate(session: ObservedSession) -> FloatArray:
    stage, tilt = session.stage_rate_rad_s, session.angle_rad[1]
    return np.asarray(stage[:, 1] * np.sin(tilt) + stage[:, 2] * np.cos(tilt))


def _edges(session: ObservedSession) -> list[tuple[str, FloatArray, FloatArray]]:
    """Return the time since the last start or end of a move, and the sign of its jerk."""
    edges: list[tuple[str, FloatArray, FloatArray]] = []
    for axis, moves in zip(AXES, session.moves, strict=True):
        for name, begin_s, sign in (
            (f"start_{axis}", moves.start_s, moves.direction),
            (f"end_{axis}", moves.end_s, -moves.direction),
        ):
            if not begin_s.size:
                continue
            row = np.searchsorted(begin_s, session.block_time_s, side="right") - 1
            since = session.block_time_s - begin_s[np.maximum(row, 0)]
            inside = (row >= 0) & (since < EDGE_S)
            edges.append((name, np.where(inside, since, np.nan), np.where(inside, sign[row], 0.0)))
    return edges


def _noise_families(session: ObservedSession, residual: FloatArray) -> list[Family]:
    """Return spectrum and Allan deviation of the residual, as decibels of power."""
    rate_hz = session.sampling.rate_hz
    periodogram = Periodogram.of(residual, rate_hz)
    edges = np.geomspace(LOWEST_HZ, rate_hz / 2.0, SPECTRUM_BINS + 1)
    bins = [periodogram.band(low, high).density for low, high in pairwise(edges)]
    centres = np.sqrt(edges[1:] * edges[:-1])
    density = np.array([power.mean(axis=0) if len(power) else np.full(3, np.nan) for power in bins])
    frequency = np.tile(centres, 3)
    axes = tuple(np.repeat(list(SENSOR_AXES), SPECTRUM_BINS).tolist())
    families = [
        Family("spectrum", "spectrum of the residual", "dB", "frequency, Hz", frequency, axes,
               10.0 * np.log10(density.T.reshape(-1)), 0.02)
    ]  # fmt: skip
    sizes = [s for s in (round(t * rate_hz) for t in ALLAN_S) if 0 < 6 * s < len(residual)]
    summed = np.concatenate([np.zeros((1, 3)), np.cumsum(residual, axis=0)])
    deviations = []
    for size in sizes:
        means = (summed[size:] - summed[:-size]) / size
        difference = means[size:] - means[:-size]
        deviations.append(np.mean(difference**2, axis=0))
    power = 10.0 * np.log10(np.array(deviations).reshape(-1, 3).T.reshape(-1))
    families.append(
        Family("allan", "Allan deviation of the residual", "dB", "averaging time, s",
               np.tile(np.array(sizes) / rate_hz, 3),
               tuple(np.repeat(list(SENSOR_AXES), len(sizes)).tolist()), power, 0.02)
    )  # fmt: skip
    return families


def _motion_families(session: ObservedSession) -> list[Family]:
    """Return start delays, speeds and accelerations, and the positions at rest."""
    delay_axis, delay_x, delays = [], [], []
    for name, moves in zip(AXES, session.moves, strict=True):
        if moves.start_s.size >= 2:
            delay = 1e3 * (moves.start_s - moves.command_s)
            # A stall delays some replies in a recording, but not in a replay.
            scatter = ROBUST_STD * float(np.median(np.abs(delay - np.median(delay))))
            delays += [float(np.median(delay)), scatter]
            delay_x += [0.0, 1.0]
            delay_axis += [name, name]
    fitted = session.reference.move_fit.parameters
    logarithms = 100.0 * np.concatenate([fitted.log_speed, fitted.log_acceleration])
    speeds = len(fitted.log_speed)
    rest_axis, rest_x, rests = [], [], []
    polls, table = session.reference.move_fit.polls, session.reference.move_fit.table
    for axis, moves in enumerate(session.moves):
        if polls is None or not moves.end_s.size:
            continue
        targets = table.to_steps[np.flatnonzero(table.axis == axis)]
        until_s = np.append(moves.start_s[1:], session.time_s[-1])
        for end_s, stop_s, target in zip(moves.end_s, until_s, targets, strict=True):
            count = polls.count_at_rest(axis, end_s + 0.1, stop_s)
            rests.append(float(count - target) if count is not None else np.nan)
            rest_x.append(float(end_s - session.time_s[0]))
            rest_axis.append(AXES[axis])
    return [
        Family("start_delay", "delay from order to start of a move (median, scatter)", "ms",
               "median 0, scatter 1", np.array(delay_x), tuple(delay_axis), np.array(delays),
               0.002),
        Family("speed", "speeds and accelerations that the unit obeyed", "%", "class of speeds",
               np.arange(logarithms.size, dtype=np.float64),
               ("",) * speeds + AXES, logarithms, 0.002),
        Family("rest_position", "rest positions minus ordered positions", "steps",
               "time since the start, s", np.array(rest_x), tuple(rest_axis), np.array(rests), 0.3),
    ]  # fmt: skip


def _latency_families(session: ObservedSession) -> list[Family]:
    """Return quantiles of the latencies, and the time in stalls of the host."""
    samples = session.samples
    excess = samples.host_s - samples.time_s
    excess = excess - np.min(excess)
    is_late = excess > STALL_FACTOR * float(np.median(excess)) / np.log(2.0)
    raw = session.recording.ptu_positions()
    answer = (times_ns(raw["first_byte_time"]) - times_ns(raw["request_time"])) * 1e-9
    # Lost samples lengthen some intervals, and are a statistic of their own.
    spacing = np.diff(samples.host_s)[np.diff(samples.number) == 1]
    families = []
    for key, title, values in (
        ("latency", "latency of the board's frames above the smallest", excess[~is_late]),
        ("jitter", "interval between arrivals of frames", spacing),
        ("answer_time", "answer time of the unit", answer),
    ):
        quantiles = 1e3 * np.quantile(values, QUANTILES)
        families.append(
            Family(key, title, "ms", "quantile", np.array(QUANTILES), ("",) * len(QUANTILES),
                   quantiles, 0.001)
        )  # fmt: skip
    # Samples that waited for one stall arrive together, so each stall has one longest delay.
    late_s, arrival_s = excess[is_late], samples.host_s[is_late]
    groups = np.split(late_s, np.flatnonzero(np.diff(arrival_s) > SAME_STALL_S) + 1)
    lengths_s = np.array([group.max() for group in groups if group.size])
    stalls = 1e3 * np.array([lengths_s.sum(), lengths_s.max(initial=0.0)])
    families.append(
        Family("stalls", "stalls of the host", "ms", "total 0, longest 1", np.arange(2.0),
               ("", ""), stalls, 1.0, is_of_rare_events=True)
    )  # fmt: skip
    return families


def _lost_family(session: ObservedSession) -> Family:
    """Return the share of the samples since the start that are missing by the board's counter.

    All values contain the losses at the start, so that a wrong share is more visible than in
    separate parts of the session.
    """
    samples = session.samples
    time_s = samples.time_s
    steps = np.diff(samples.number.astype(np.int64))
    lost = np.where(np.diff(samples.segment) == 0, steps - 1, 0)
    if lost.sum() <= FEW_LOST:
        lost[:] = 0
    until_s = np.linspace(time_s[0], time_s[-1], TIME_BINS + 1)[1:]
    received = np.searchsorted(time_s, until_s, side="right")
    missing = np.append(0, np.cumsum(lost))[received - 1]
    return Family("lost", "lost samples since the start", "%", "time since the start, s",
                  until_s - time_s[0], ("",) * TIME_BINS, 100.0 * missing / (missing + received),
                  0.01)  # fmt: skip


def _clock_families(session: ObservedSession) -> list[Family]:
    """Return skew and innovation of the board's clock."""
    samples = session.samples
    period_s = samples.period_s
    innovations = []
    for step_s in CLOCK_S:
        size = max(1, round(step_s / period_s))
        chosen = samples.time_s[::size]
        number = samples.number[::size].astype(np.float64)
        if chosen.size < 8:
            break
        slope = np.diff(chosen) / np.diff(number)
        innovations.append(1e6 * float(np.std(np.diff(slope))) / period_s)
    values = np.array([samples.clock.skew_ppm, *innovations])
    return [
        Family("clock", "skew of the board's clock and its change", "ppm",
               "skew 0, change over 1 s, 3 s, 10 s", np.arange(values.size, dtype=np.float64),
               ("",) * values.size, values, 0.01)
    ]  # fmt: skip
