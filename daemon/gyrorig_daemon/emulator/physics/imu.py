"""Inertial sensor of a board: from the motion of the stage to raw counts.

    y = G omega(t - tau) filtered + bias + noise,   counts = round(y / scale), clipped

with G = S T M. Samples are computed in blocks on a fixed grid of the sensor's own oscillator. A
block is computed in advance. If a command changes the motion within it, it is computed again from
the same random draws, so that samples that were already sent stay true and nothing depends on the
order of queries. Further errors of a sensor are in `hooks`.
"""

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.bias_noise import BiasWander, white_step_sigma
from gyrorig_daemon.emulator.physics.effects.board_effects import MotionSamples
from gyrorig_daemon.emulator.physics.effects.rig_hooks import BoardHooks
from gyrorig_daemon.emulator.physics.lag_lines import LagLine, lag_lines
from gyrorig_daemon.emulator.physics.lowpass import block_filter
from gyrorig_daemon.emulator.physics.stage_motion import Stage, StageMotion
from gyrorig_daemon.emulator.physics.temperature import BoardTemperature, TemperatureCurve

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SUBSTEP_HZ = 8000.0  # at least; an edge within a substep keeps its area, and therefore its time
BLOCK_S = 0.08
INT16_MAX = 32767


@dataclass(frozen=True, slots=True, eq=False)
class ImuTruth:
    """True properties of a sensor. Scales are nominal; errors are in `gain`."""

    odr_hz: float  # true rate of the sensor's own oscillator
    bandwidth_hz: float  # -3 dB of the second-order Butterworth
    gain: FloatArray  # G = S T M, (3, 3)
    mounting: FloatArray  # M, stage to sensor, (3, 3)
    bias_rad_s: FloatArray  # at power-on, (3,)
    noise_density_rad_s_rthz: FloatArray  # one-sided, before the low-pass, (3,)
    bias_instability_rad_s: FloatArray  # flicker coefficient, (3,)
    rate_random_walk: FloatArray  # rad/s per sqrt(s), (3,)
    tau_s: float  # lag of a sample behind the motion, without the low-pass
    gyro_scale_rad_s: float  # per count, nominal
    gyro_limit_rad_s: float  # full scale; samples beyond it are flagged as saturated
    accel_scale_m_s2: float
    accel_gain: FloatArray  # (3,)
    accel_bias_m_s2: FloatArray  # (3,)
    accel_noise_m_s2: float  # standard deviation of a sample
    ambient_degc: float
    self_heating_k: float
    warm_up_s: float
    soak_k: float = 0.0  # see `temperature`
    soak_s: tuple[float, float] = (0.0, 120.0)
    temperature_curve: TemperatureCurve | None = None
    # One-sided, of noise that arises behind the low-pass, (3,).
    noise_floor_rad_s_rthz: FloatArray = field(default_factory=lambda: np.zeros(3))

    def without_noise(self) -> "ImuTruth":
        """Return the same sensor without noise and bias wander."""
        return replace(
            self,
            noise_density_rad_s_rthz=np.zeros(3),
            bias_instability_rad_s=np.zeros(3),
            rate_random_walk=np.zeros(3),
            noise_floor_rad_s_rthz=np.zeros(3),
            accel_noise_m_s2=0.0,
        )


@dataclass(frozen=True, slots=True, eq=False)
class SampleBlock:
    """Samples in order of time."""

    first: int  # number of the first sample since the sensor started
    time_s: FloatArray  # of data-ready, since the origin, (n,)
    gyro: IntArray  # (n, 3)
    rate_rad_s: FloatArray  # before rounding to counts, (n, 3)
    accel: IntArray  # (n, 3)
    temperature_degc: FloatArray  # (n,)
    saturated: NDArray[np.bool_]  # (n,)
    bias_rad_s: FloatArray  # mean true bias over the block, (3,)


class BiasPath:
    """True bias per second of time, small enough to keep for a night."""

    def __init__(self) -> None:
        """Start without values."""
        self._seconds: list[int] = []
        self._sums: list[FloatArray] = []
        self._counts: list[int] = []

    def add(self, time_s: float, bias: FloatArray) -> None:
        """Add the mean bias of a block; blocks come in order of time."""
        second = int(time_s)
        if not self._seconds or self._seconds[-1] != second:
            self._seconds.append(second)
            self._sums.append(np.zeros(3))
            self._counts.append(0)
        self._sums[-1] = self._sums[-1] + bias
        self._counts[-1] += 1

    def mean(self, first_s: float, last_s: float) -> FloatArray | None:
        """Return the mean over all seconds that overlap a time, None without values."""
        interval = slice(
            bisect_left(self._seconds, int(first_s)), bisect_right(self._seconds, int(last_s))
        )
        count = sum(self._counts[interval])
        return np.asarray(sum(self._sums[interval], np.zeros(3)) / count) if count else None


class ImuModel:
    """The sensor as a stream of blocks."""

    def __init__(
        self,
        truth: ImuTruth,
        stage: Stage,
        start_s: float,
        rng: np.random.Generator,
        multiple: int = 1,
        hooks: BoardHooks | None = None,
    ) -> None:
        """Power on at `start_s` after the origin.

        Args:
            truth: the sensor.
            stage: the stage on which it is mounted.
            start_s: time of power-on.
            rng: source of its noise.
            multiple: the number of samples per block is a multiple of this.
            hooks: errors other than its noise and its gain.
        """
        self.truth = truth
        self._hooks = hooks or BoardHooks()
        self._stage = stage
        self._period_s = 1.0 / truth.odr_hz
        self._substeps = max(1, math.ceil(SUBSTEP_HZ * self._period_s))
        self._samples = multiple * max(1, round(BLOCK_S * truth.odr_hz / multiple))
        self._dt_s = self._period_s / self._substeps
        self._filter = block_filter(truth.bandwidth_hz, self._dt_s, self._substeps, self._samples)
        self._start_s = start_s
        self._temperature = BoardTemperature(
            truth.ambient_degc,
            truth.self_heating_k,
            truth.warm_up_s,
            start_s,
            truth.soak_k,
            truth.soak_s,
            truth.temperature_curve,
        )
        self._noise_rng, self._wander_rng, self._accel_rng = rng.spawn(3)
        self._sigma = white_step_sigma(truth.noise_density_rad_s_rthz, self._dt_s)
        # Its own stream, and only with a floor: all other noise is the same without one.
        self._floor_rng = rng.spawn(1)[0] if truth.noise_floor_rad_s_rthz.any() else None
        self._floor_sigma = white_step_sigma(truth.noise_floor_rad_s_rthz, self._period_s)
        self._wander = BiasWander(
            truth.bias_instability_rad_s,
            truth.rate_random_walk,
            self._samples * self._period_s,
            self._wander_rng,
        )
        self._state: FloatArray = np.zeros((2, 3))
        self._end_state: FloatArray = np.zeros((2, 3))
        self._lag_line: LagLine | None = None  # of the last sample of the previous block
        self._end_lag_line: LagLine | None = None
        self._wander_from, self._wander_to = np.zeros(3), np.zeros(3)
        self._noise: FloatArray = np.zeros((0, 3))
        self._floor_noise: FloatArray = np.zeros(3)
        self._accel_noise: FloatArray = np.zeros((0, 3))
        self._jitter_substeps: FloatArray | None = None
        self._first = -self._samples
        self._revision = -1
        self._block: SampleBlock | None = None

    def samples_before(self, time_s: float) -> int:
        """Return the number of samples that are ready before a time."""
        return max(math.ceil((time_s - self._start_s) / self._period_s) - 1, 0)

    def next_block(self) -> SampleBlock:
        """Draw and compute the next block."""
        self._first += self._samples
        self._state, self._lag_line = self._end_state, self._end_lag_line
        self._wander_from, self._wander_to = self._wander_to, self._wander.advance()
        count = self._samples * self._substeps
        if self._sigma.any():
            self._noise = self._sigma * self._noise_rng.standard_normal((count, 3))
        else:
            self._noise = np.zeros((count, 3))
        if self._floor_rng is not None:
            draws = self._floor_rng.standard_normal((self._samples, 3))
            self._floor_noise = self._floor_sigma * draws
        self._accel_noise = self.truth.accel_noise_m_s2 * self._accel_rng.standard_normal(
            (self._samples, 3)
        )
        for effect in self._hooks.count_effects:
            effect.draw(self._samples)
        if self._hooks.jitter is not None:
            lag_s = self._hooks.jitter.draw_s(self._samples)
            self._jitter_substeps = np.minimum(lag_s / self._dt_s, self._substeps)
        return self._compute()

    def recompute_if_moved(self) -> SampleBlock | None:
        """Return the present block again if a command has changed the motion, else None."""
        if self._first < 0 or self._stage.revision == self._revision:
            return None
        return self._compute()

    def _compute(self) -> SampleBlock:
        truth, n, hooks = self.truth, self._samples, self._hooks
        self._revision = self._stage.revision
        ready_s = self._start_s + self._first * self._period_s
        time_s: FloatArray = ready_s + self._period_s * (np.arange(n, dtype=np.float64) + 1.0)
        output: FloatArray = np.empty((n, 3))
        line, state = self._lag_line, self._state
        lines = (
            lag_lines(hooks, ready_s, time_s) if hooks.lags else [(0, LagLine(ready_s, 0.0, 0.0))]
        )
        for first, now in lines:
            if line is not None and not line.continues(now, ready_s):
                # The clock jumps, not the sensor: its low-pass has followed the motion until now.
                state = state + self._settled_state(now, ready_s)
                state = state - self._settled_state(line, ready_s)
            motion_s = ready_s - truth.tau_s - now.at(ready_s)
            motion = self._stage.motion(
                motion_s, now.motion_duration_s(self._dt_s), n * self._substeps
            )
            inputs = self._sensor_rate(motion, ready_s) + self._noise
            outputs, end_state = self._filter.run(state, inputs, self._jitter_substeps)
            output[first:] = outputs[first:]
            line = now
        self._end_state, self._end_lag_line = end_state, line
        block_share = (np.arange(n) + 1.0)[:, None] / n
        bias = (
            truth.bias_rad_s
            + self._wander_from
            + block_share * (self._wander_to - self._wander_from)
        )
        for effect in hooks.bias_effects:
            bias = bias + effect.added_rad_s(time_s, self._temperature)
        measured = output + bias + self._floor_noise
        if hooks.limit_rad_s is not None:
            measured = np.clip(measured, -hooks.limit_rad_s, hooks.limit_rad_s)
        measured = measured * hooks.count_factor
        counts = np.rint(measured / truth.gyro_scale_rad_s).astype(np.int64)
        is_saturated = (np.abs(counts) > INT16_MAX) | (np.abs(measured) > truth.gyro_limit_rad_s)
        counts = np.clip(counts, -INT16_MAX - 1, INT16_MAX)
        for word in hooks.count_effects:
            counts = word.changed(counts)
        return SampleBlock(
            first=self._first,
            time_s=time_s,
            gyro=counts,
            rate_rad_s=measured,
            accel=self._accel(motion_s + self._period_s, time_s),
            temperature_degc=self._temperature.degc(time_s),
            saturated=np.asarray(is_saturated.any(axis=1)),
            bias_rad_s=bias.mean(axis=0),
        )

    def _settled_state(self, line: LagLine, ready_s: float) -> FloatArray:
        """Return the low-pass's state before a block if its input had one lag until then, (2, 3).

        Only the motion counts, during one block: the difference between two lags is what is used.
        """
        count = self._samples * self._substeps
        dt_s = line.motion_duration_s(self._dt_s)
        begin_s = ready_s - self.truth.tau_s - line.at(ready_s) - count * dt_s
        rates = self._stage.motion(begin_s, dt_s, count).body_rate_rad_s @ self.truth.gain.T
        at_first_rate = np.array([rates[0], np.zeros(3)])
        return self._filter.run(at_first_rate, rates)[1]

    def _sensor_rate(self, motion: StageMotion, ready_s: float) -> FloatArray:
        """Return the rate at the sensor element in each substep, (m, 3)."""
        truth, hooks = self.truth, self._hooks
        if not hooks.mount_effects and not hooks.rate_effects:
            return np.asarray(motion.body_rate_rad_s @ truth.gain.T)
        middles = np.arange(len(motion.pan_rad), dtype=np.float64) + 0.5
        time_s: FloatArray = ready_s + self._dt_s * middles
        force: FloatArray = self._stage.gravity_during(motion) @ truth.mounting.T
        sensor_rad_s: FloatArray = motion.body_rate_rad_s @ truth.gain.T
        if hooks.mount_effects:
            rates: FloatArray = motion.body_rate_rad_s @ truth.mounting.T
            for mount in hooks.mount_effects:
                rates, force = mount.turned(time_s, rates), mount.turned(time_s, force)
            sensor_rad_s = rates @ (truth.gain @ truth.mounting.T).T
        samples = MotionSamples(
            time_s=time_s,
            pan_rad=motion.pan_rad,
            tilt_rad=motion.tilt_rad,
            pan_rate_rad_s=motion.pan_rate_rad_s,
            tilt_rate_rad_s=motion.tilt_rate_rad_s,
            sensor_rad_s=sensor_rad_s,
            full_scale_rad_s=INT16_MAX * truth.gyro_scale_rad_s,
            force_m_s2=force,
            temperature=self._temperature,
            pan=self._stage.pan,
            tilt=self._stage.tilt,
        )
        for effect in hooks.rate_effects:
            sensor_rad_s = sensor_rad_s + effect.added_rad_s(samples)
        return sensor_rad_s

    def _accel(self, start_s: float, time_s: FloatArray) -> IntArray:
        truth = self.truth
        stage = self._stage.gravity_stage_m_s2(start_s, self._period_s, self._samples)
        sensor_m_s2 = stage @ truth.mounting.T
        for mount in self._hooks.mount_effects:
            sensor_m_s2 = mount.turned(time_s, sensor_m_s2)
        measured_m_s2 = sensor_m_s2 * truth.accel_gain + truth.accel_bias_m_s2
        counts = np.rint((measured_m_s2 + self._accel_noise) / truth.accel_scale_m_s2).astype(
            np.int64
        )
        return np.clip(counts, -INT16_MAX - 1, INT16_MAX)
