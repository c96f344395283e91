"""Segments of a fit to reference attitudes as block means, with their signal states."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.attitude.attitude_fit import AttitudeFit
from gyrorig_solver.model import RecordingContext, SignalState

MAX_STEP_S = 0.01  # steps for functions of the rates; hand motion is slower
BLOCK_RATE_PER_BAND = 8.0  # block rate over the band
MIN_SEGMENT_S = 2.0  # shorter segments have too few coefficients in the band


@dataclass(frozen=True, eq=False)
class AttitudeState(SignalState):
    """A signal state with the specific force that the board's accelerometer measured."""

    measured_force_m_s2: FloatArray | None = None  # (n, 3), stage frame

    @cached_property
    def specific_force_m_s2(self) -> FloatArray:
        """The reading of the accelerometer, zeros without one, shape (n, 3)."""
        return (
            np.zeros((self.interval_count, 3))
            if self.measured_force_m_s2 is None
            else self.measured_force_m_s2
        )


@dataclass(frozen=True, slots=True, eq=False)
class BlockSegment:
    """One segment as block means, with its signal state."""

    recording: int
    state: AttitudeState
    measured: FloatArray  # (blocks, 3), the gyro
    modelled: FloatArray  # (blocks, 3), G w + b of the fit
    rate: FloatArray  # (blocks, 3), of the stage, from the gyro
    slope: FloatArray  # (blocks, 3), of the gyro by the lag; zero at rest, where it is noise
    time_s: FloatArray  # (blocks,)
    in_band_count: int  # coefficients in the band
    solver_segment: int = 0  # number of this segment in the fit
    # (blocks, 3), of the causes that the fit has subtracted from the gyro's rates
    effect: FloatArray | float = 0.0

    @property
    def block_count(self) -> int:
        """The number of block means."""
        return int(self.measured.shape[0])

    @property
    def residual(self) -> FloatArray:
        """The residual of gain, bias and time offset, with clipped glitches, (blocks, 3)."""
        return self.measured - self.modelled

    def effect_at_steps(
        self, effect: FloatArray, begin_s: FloatArray, end_s: FloatArray
    ) -> FloatArray:
        """Return block means (blocks, 3) as means over steps of the reference, (n, 3).

        The integral is interpolated, so that the steps of a block have the same mean as the block.
        """
        edges_s = self.state.edges_s[:: self.state.instants_per_block]
        steps = np.diff(edges_s)[:, None]
        integral = np.concatenate([np.zeros((1, 3)), np.cumsum(effect * steps, axis=0)])
        course = CubicSpline(edges_s, integral)
        first, last = (np.clip(t, edges_s[0], edges_s[-1]) for t in (begin_s, end_s))
        span_s = np.maximum(last - first, 1e-9)[:, None]
        means = (course(last) - course(first)) / span_s
        # less than half of the step is in the blocks
        outside = last - first < 0.5 * (end_s - begin_s)
        means[outside] = effect[-1]
        return np.asarray(means, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class AccelerometerReadings:
    """The accelerometer readings of each recording, None without an accelerometer."""

    readings: tuple[tuple[FloatArray, FloatArray] | None, ...]  # time (n,), force (n, 3)

    def at(self, recording: int, time_s: FloatArray) -> FloatArray | None:
        """Return the force at given times, (m, 3), by linear interpolation.

        Rows that are not finite are ignored.
        """
        reading = self.readings[recording]
        if reading is None:
            return None
        is_known = np.isfinite(reading[1]).all(axis=1)
        read_s, force = reading[0][is_known], reading[1][is_known]
        return np.stack([np.interp(time_s, read_s, axis) for axis in force.T], axis=1)


def build_block_segments(
    fit: AttitudeFit, contexts: Sequence[RecordingContext], readings: AccelerometerReadings
) -> list[BlockSegment]:
    """Return the block means of each segment that is long enough.

    Args:
        fit: the fit of the base model.
        contexts: of each recording.
        readings: of each recording's accelerometer.

    Raises:
        InputError: no segment is long enough.
    """
    solver, with_lag = fit.solver, fit.solver.recordings_with_lag(fit.linearised)
    inverse = np.linalg.inv(solver.gain).T
    segments = []
    for k, (segment, recording) in enumerate(
        zip(solver.segments, solver.recording_of_segment, strict=True)
    ):
        track = segment.track
        steps_per_interval = max(1, int(MAX_STEP_S / track.step_s))
        step_s = steps_per_interval * track.step_s
        intervals_per_block = max(1, int(1.0 / (BLOCK_RATE_PER_BAND * fit.band_hz * step_s)))
        block_count = track.begin_s.size // (intervals_per_block * steps_per_interval)
        if block_count * intervals_per_block * step_s < MIN_SEGMENT_S:
            continue
        cleaned = solver.clean_segment(k)
        n = block_count * intervals_per_block * steps_per_interval
        rate = _group_means(
            (cleaned.measured[:n] - solver.bias_of(k)) @ inverse, steps_per_interval
        )
        edges_s = track.edge_s[: n + 1 : steps_per_interval]
        middle_s = (edges_s[:-1] + edges_s[1:]) / 2.0
        state = AttitudeState.build(
            edges_s,
            None,
            np.ones(block_count * intervals_per_block, dtype=np.bool_),
            instants_per_block=intervals_per_block,
            intervals_per_instant=1,
            bandwidth_hz=None,
            gain=solver.gain,
            bias_rad_s=solver.bias_of(k),
            rate_rad_s=rate,
            context=contexts[recording],
        )
        state = replace(
            state, measured_force_m_s2=readings.at(recording, middle_s + solver.lag_s_of(k))
        )
        without_effect = _group_means(
            cleaned.measured[:n], intervals_per_block * steps_per_interval
        )
        effect = np.zeros_like(without_effect)
        if solver.effects is not None:
            effect = _group_means(solver.effects[k][:n], intervals_per_block * steps_per_interval)
        segments.append(
            BlockSegment(
                recording=recording,
                solver_segment=k,
                state=state,
                measured=without_effect + effect,
                effect=effect,
                modelled=without_effect
                - _group_means(cleaned.residual[:n], intervals_per_block * steps_per_interval),
                rate=_group_means(rate, intervals_per_block),
                slope=_group_means(cleaned.slope[:n], intervals_per_block * steps_per_interval)
                * float(recording in with_lag),
                time_s=middle_s.reshape(block_count, intervals_per_block).mean(axis=1),
                in_band_count=min(
                    block_count,
                    int(2.0 * fit.band_hz * block_count * intervals_per_block * step_s),
                ),
            )
        )
    if not segments:
        raise InputError(
            f"the gyroscope and the reference attitudes have no {MIN_SEGMENT_S:g} s in common "
            "without a gap or a clipped sample",
            "find out why samples or attitudes are missing; if the sensor's range is too small, "
            "use a larger full scale or turn more slowly",
        )
    return segments


def _group_means(values: FloatArray, group_size: int) -> FloatArray:
    """Return means over groups of rows, (n / group_size, 3)."""
    return np.asarray(values.reshape(-1, group_size, 3).mean(axis=1), dtype=np.float64)
