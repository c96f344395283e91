"""The signal that a cause acts on: one part of a board's series at the current state of a fit.

What to use when: `SignalState.build` from plain arrays (the edges of a grid of intervals, corrected
for the lag of the samples behind the motion, and the reference's pan and tilt at these edges);
`measure_sensor_rate` and `measure_stage_rate` for the signal of a rate in the block means;
`stage_rate_change` and `stage_rate_derivative` to convert axis angles to stage rates.

The grid has `intervals_per_instant` intervals per sample instant, an odd number, so that one
interval is centred on the instant, and `instants_per_block` instants per block mean. On the fine
grid of the series this reproduces the samples exactly. A coarser grid (a few intervals per block,
each representing an instant) is accurate enough for derivatives and several times faster.

Other causes can have changed a state already: `with_angles`, `with_rate`, `with_sensor`,
`with_output` and `with_delay` return the signal at the next stages. `at_stage`, `at_sensor` and
`at_output` return the signal at a stage without the later stages.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.sparse import csr_array

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.model.angle_waves import AngleWaves
from gyrorig_solver.model.drive_effects import second_derivative
from gyrorig_solver.model.hermite_interpolation import HermiteInterpolator
from gyrorig_solver.model.low_pass import LowPass
from gyrorig_solver.model.recording_context import RecordingContext
from gyrorig_solver.model.sampled_output import SampledOutput
from gyrorig_solver.model.signal_arrays import axis_rows, is_on_all_axes
from gyrorig_solver.reference import StageRateJacobian

MIN_AXIS_RATE_RAD_S = 1e-4  # a slower axis is at rest; a step (0.05 deg) would take 10 s


@dataclass(frozen=True, eq=False)
class SignalState:
    """One part of a series; see the module. Arrays over n intervals."""

    edges_s: FloatArray  # (n + 1,)
    angle_rad: FloatArray  # (2, n + 1), pan and tilt at the edges
    motion_known: BoolArray  # (n,)
    rate_rad_s: FloatArray  # (n, 3), stage frame; zero if unknown
    axis_turn: StageRateJacobian  # derivative of that rate by the angles (rad)
    gain: FloatArray  # (3, 3), G = S T M
    bias_rad_s: FloatArray  # (3,)
    context: RecordingContext
    used_instants: BoolArray  # (block_count * instants_per_block,)
    instants_per_block: int
    intervals_per_instant: int
    lead_instants: int  # instants before the first block, for the filter to settle
    low_pass: LowPass | None
    has_angles: bool  # False for a reference without pan and tilt
    previous_direction: tuple[float, float]  # of each axis' last move before this part, or 0
    # Changes by causes at earlier stages; None is no change.
    motors_running: BoolArray | None = None  # (2, n), even if the stage does not turn
    added_sensor_rate_rad_s: FloatArray | None = None  # (n, 3), before the low-pass
    added_output_rate_rad_s: FloatArray | None = None  # (n, 3), after the low-pass
    sampling_delay_s: FloatArray | None = None  # (instants,), sampling time minus timestamp

    @classmethod
    def build(
        cls,
        edges_s: FloatArray,
        angle_rad: FloatArray | None,
        used_instants: BoolArray,
        *,
        instants_per_block: int,
        intervals_per_instant: int,
        bandwidth_hz: float | None,
        gain: FloatArray,
        bias_rad_s: FloatArray | None = None,
        rate_rad_s: FloatArray | None = None,
        motion_known: BoolArray | None = None,
        context: RecordingContext | None = None,
        previous_direction: tuple[float, float] = (0.0, 0.0),
    ) -> Self:
        """Return the state of one part of a series.

        Args:
            edges_s: of the intervals, shape (n + 1,), n a multiple of `intervals_per_instant`.
                Intervals beyond `used_instants.size * intervals_per_instant` precede the first
                block.
            angle_rad: pan and tilt at the edges, shape (2, n + 1); None if there are none.
            used_instants: which instants are used, for whole blocks.
            instants_per_block: instants per block mean.
            intervals_per_instant: odd.
            bandwidth_hz: of the sensor's low-pass; None to omit the low-pass.
            gain: current G of the fit.
            bias_rad_s: current bias of the fit.
            rate_rad_s: mean stage rate between edges, (n, 3), nan if unknown; by default computed
                from the angles.
            motion_known: (n,), False if the angles are not reliable.
            context: of the recording.
            previous_direction: the sign of each axis' last motion before this part, 0 if unknown.
        """
        n = edges_s.size - 1
        angle = np.zeros((2, n + 1)) if angle_rad is None else angle_rad
        angle_rate, axis_turn = StageRateJacobian.of_angles(angle, edges_s, (1.0, 1.0))
        rate = angle_rate if rate_rad_s is None else rate_rad_s
        is_known: BoolArray = np.asarray(np.isfinite(rate).all(axis=1), dtype=np.bool_)
        if motion_known is not None:
            is_known = np.asarray(is_known & motion_known)
        step_s = float(edges_s[-1] - edges_s[0]) / n
        return cls(
            edges_s=edges_s,
            angle_rad=angle,
            motion_known=is_known,
            rate_rad_s=np.where(is_known[:, None], rate, 0.0),
            axis_turn=axis_turn,
            gain=gain,
            bias_rad_s=np.zeros(3) if bias_rad_s is None else bias_rad_s,
            context=context
            or RecordingContext(begin_s=float(edges_s[0]), end_s=float(edges_s[-1])),
            used_instants=used_instants,
            instants_per_block=instants_per_block,
            intervals_per_instant=intervals_per_instant,
            lead_instants=n // intervals_per_instant - used_instants.size,
            low_pass=None if bandwidth_hz is None else LowPass(bandwidth_hz, 1.0 / step_s),
            has_angles=angle_rad is not None,
            previous_direction=previous_direction,
        )

    @cached_property
    def lacks_angles(self) -> bool:
        """Whether the board turns about unknown axes of a unit; at rest, no angle changes."""
        return not self.has_angles and bool(self.rate_rad_s.any())

    @cached_property
    def is_at_rest(self) -> bool:
        """Whether the board does not turn."""
        return not (self.lacks_angles or self.moving.any())

    @property
    def interval_count(self) -> int:
        """The number of intervals."""
        return self.edges_s.size - 1

    @property
    def _first_instant(self) -> int:
        return self.intervals_per_instant // 2 + self.lead_instants * self.intervals_per_instant

    @property
    def block_count(self) -> int:
        """The number of block means."""
        return self.used_instants.size // self.instants_per_block

    @cached_property
    def step_s(self) -> float:
        """The mean width of an interval."""
        return float(self.edges_s[-1] - self.edges_s[0]) / self.interval_count

    @cached_property
    def time_s(self) -> FloatArray:
        """Middles of the intervals, shape (n,)."""
        return np.asarray((self.edges_s[:-1] + self.edges_s[1:]) / 2.0, dtype=np.float64)

    @property
    def tilt_rad(self) -> FloatArray:
        """Tilt at the middles, shape (n,)."""
        return self.axis_turn.tilt_rad

    @cached_property
    def pan_rad(self) -> FloatArray:
        """Pan at the middles, shape (n,)."""
        return np.asarray((self.angle_rad[0, :-1] + self.angle_rad[0, 1:]) / 2.0, np.float64)

    @cached_property
    def angle_waves(self) -> AngleWaves:
        """Waves of the angles at the edges."""
        return AngleWaves(self.angle_rad)

    @cached_property
    def angle_acceleration_rad_s2(self) -> FloatArray:
        """The second derivative of the angles at the edges, shape (2, n + 1)."""
        return second_derivative(self.edges_s, self.angle_rad)

    @property
    def pan_rate_rad_s(self) -> FloatArray:
        """Pan rate, shape (n,)."""
        return self.axis_turn.pan_rate_rad_s

    @cached_property
    def tilt_rate_rad_s(self) -> FloatArray:
        """Tilt rate, shape (n,)."""
        return np.asarray(np.diff(self.angle_rad[1]) / self.axis_turn.width_s, np.float64)

    @cached_property
    def moving(self) -> BoolArray:
        """Whether the motors of pan and tilt turn, shape (2, n)."""
        if self.motors_running is not None:
            return self.motors_running
        rates = np.stack([self.pan_rate_rad_s, self.tilt_rate_rad_s])
        return np.asarray(np.abs(rates) > MIN_AXIS_RATE_RAD_S, dtype=np.bool_)

    @cached_property
    def sensor_rate_rad_s(self) -> FloatArray:
        """The rate about the sensor's axes, G omega, shape (n, 3), without bias."""
        rate = (self.gain @ self.rate_rad_s.T).T
        return rate if self.added_sensor_rate_rad_s is None else rate + self.added_sensor_rate_rad_s

    @cached_property
    def specific_force_m_s2(self) -> FloatArray:
        """The specific force at rest in the stage frame of a level rig, shape (n, 3)."""
        g = self.context.site.gravity_m_s2
        zero = np.zeros(self.interval_count)
        return np.column_stack([zero, g * self.axis_turn.sine, g * self.axis_turn.cosine])

    @cached_property
    def filtered_rad_s(self) -> FloatArray:
        """G omega after the low-pass, shape (n, 3)."""
        rate = self.low_pass_filtered(self.sensor_rate_rad_s)
        return rate if self.added_output_rate_rad_s is None else rate + self.added_output_rate_rad_s

    @cached_property
    def filtered_slope_rad_s2(self) -> FloatArray:
        """Its time derivative, shape (n, 3)."""
        return np.asarray(np.gradient(self.filtered_rad_s, self.step_s, axis=0), np.float64)

    def low_pass_filtered(self, sensor_rate: FloatArray) -> FloatArray:
        """Return mean rates of shape (..., n, 3) after the sensor's low-pass, from a steady state.

        The prediction of the fit uses the same filter; see `LowPass.apply_to_means`.
        """
        if self.low_pass is None:
            return sensor_rate
        return np.swapaxes(self.low_pass.apply_to_means(axis_rows(sensor_rate)), -1, -2)

    @cached_property
    def sample_times_s(self) -> FloatArray:
        """The sampling times of the blocks' samples, shape of `used_instants`."""
        return np.ascontiguousarray(self.time_s[self._first_instant :: self.intervals_per_instant])

    def block_means(self, at_instants: FloatArray) -> FloatArray:
        """Return block means, (..., blocks, 3), of (..., instants, 3).

        The mean of a block without used instants is zero.
        """
        if self.instants_per_block == 1:
            return (
                at_instants
                if self._all_used
                else np.where(self.used_instants[:, None], at_instants, 0.0)
            )
        rows = np.swapaxes(at_instants, -1, -2)
        shaped = rows.reshape(*rows.shape[:-1], self.block_count, self.instants_per_block)
        if self._all_used:
            total = shaped[..., 0] + shaped[..., 1]  # faster than a sum over a short last axis
            for k in range(2, self.instants_per_block):
                total += shaped[..., k]
            total /= self.instants_per_block
            return np.swapaxes(total, -1, -2)
        weight = self.used_instants.reshape(self.block_count, self.instants_per_block)
        count = np.maximum(weight.sum(axis=1), 1)
        return np.swapaxes(np.where(weight, shaped, 0.0).sum(axis=-1) / count, -1, -2)

    def sample_output(self, output: FloatArray) -> FloatArray:
        """Return the block means of the output of the low-pass, shape (..., n, 3)."""
        if self.sampling_delay_s is None:
            return self.block_means(
                output[..., self._first_instant :: self.intervals_per_instant, :]
            )
        return self._sample_delayed(axis_rows(output))

    def _sample_delayed(self, output: FloatArray) -> FloatArray:
        """Return block means of the output, (..., 3, n), at the delayed instants."""
        rows = output.reshape(-1, self.interval_count)
        delayed = np.empty((len(rows), self.used_instants.size))
        for k, row in enumerate(rows):
            delayed[k] = self._delayed_sampling @ row
        shaped = delayed.reshape(*output.shape[:-1], self.used_instants.size)
        return self.block_means(np.swapaxes(shaped, -1, -2))

    @cached_property
    def _delayed_sampling(self) -> csr_array:
        """The interpolation matrix from a signal (n,) to the delayed instants."""
        delay_s = 0.0 if self.sampling_delay_s is None else self.sampling_delay_s
        late = self.sample_times_s + delay_s
        return HermiteInterpolator.of(self.time_s, late).sparse_operator(self.step_s)

    @cached_property
    def sampled_output(self) -> SampledOutput:
        """The sensor's output, G omega after the low-pass, at its instants."""
        own_s = 0.0 if self.sampling_delay_s is None else self.sampling_delay_s
        instants_s = self.sample_times_s + own_s
        return SampledOutput(
            self.time_s, self.filtered_rad_s, self.filtered_slope_rad_s2, instants_s
        )

    def measure_sensor_rate(self, sensor_rate: FloatArray) -> FloatArray:
        """Return the block means of a rate at the sensor, (..., n, 3).

        A rate from `on_all_axes` is filtered once; do not write to its block means.
        """
        if self.low_pass is None:
            return self.sample_output(sensor_rate)
        if is_on_all_axes(sensor_rate):
            one_axis = self.measure_sensor_rate(sensor_rate[..., :1])
            return np.broadcast_to(one_axis, (*one_axis.shape[:-1], 3))
        means = axis_rows(sensor_rate)
        if self.sampling_delay_s is not None:
            return self._sample_delayed(self.low_pass.apply_to_means(means))
        if self._all_used and self.intervals_per_instant == 1 and self.lead_instants == 0:
            blocks = self.low_pass.apply_to_blocks(means, self.instants_per_block)
            return np.swapaxes(blocks, -1, -2)
        instants = self.low_pass.apply_to_instants(means, self.intervals_per_instant)
        return self.block_means(np.swapaxes(instants[..., self.lead_instants :], -1, -2))

    def measure_stage_rate(self, stage_rate: FloatArray) -> FloatArray:
        """Return the block means of a change of the stage's rate, (..., n, 3)."""
        if not self.motion_known.all():
            stage_rate = np.where(self.motion_known[:, None], stage_rate, 0.0)
        # The gain commutes with the low-pass. It is applied last, to the fewest values.
        rows = axis_rows(self.measure_sensor_rate(stage_rate))
        return np.swapaxes(self.gain @ rows, -1, -2)

    @cached_property
    def _all_used(self) -> bool:
        return bool(self.used_instants.all())

    def stage_rate_change(self, change_rad: FloatArray) -> FloatArray:
        """Return the exact change of the stage's rate, (n, 3), by an angle error.

        Args:
            change_rad: true minus commanded pan and tilt at the edges, shape (2, n + 1).
        """
        if not change_rad[1].any():
            return self.stage_rate_derivative(0, change_rad[0])  # linear in the pan angle
        rate, _ = StageRateJacobian.of_angles(self.angle_rad + change_rad, self.edges_s, (1.0, 1.0))
        return np.asarray(rate - self._commanded_rate_rad_s, dtype=np.float64)

    @cached_property
    def _commanded_rate_rad_s(self) -> FloatArray:
        return StageRateJacobian.of_angles(self.angle_rad, self.edges_s, (1.0, 1.0))[0]

    # ---- the signal at the next stage

    def with_angles(self, change_rad: FloatArray) -> Self:
        """Return the state with another angle of the stage, shape (2, n + 1)."""
        angle = self.angle_rad + change_rad
        rate, axis_turn = StageRateJacobian.of_angles(angle, self.edges_s, (1.0, 1.0))
        added_rate = np.where(self.motion_known[:, None], rate - self._commanded_rate_rad_s, 0.0)
        return replace(
            self,
            angle_rad=angle,
            axis_turn=axis_turn,
            rate_rad_s=self.rate_rad_s + added_rate,
            motors_running=self.moving,
        )

    def with_rate(self, change_rad_s: FloatArray) -> Self:
        """Return the state with an additional rate of the stage or the board, (n, 3)."""
        added_rate = np.where(self.motion_known[:, None], change_rad_s, 0.0)
        return replace(self, rate_rad_s=self.rate_rad_s + added_rate)

    def with_sensor(self, change_rad_s: FloatArray) -> Self:
        """Return the state with an additional rate before the low-pass, sensor frame, (n, 3)."""
        total = _sum_of_changes(self.added_sensor_rate_rad_s, change_rad_s)
        return replace(self, added_sensor_rate_rad_s=total)

    def with_output(self, change_rad_s: FloatArray) -> Self:
        """Return the state with an additional rate after the low-pass, (n, 3)."""
        total = _sum_of_changes(self.added_output_rate_rad_s, change_rad_s)
        return replace(self, added_output_rate_rad_s=total)

    def true_times_s(self, time_s: FloatArray) -> FloatArray:
        """Return the sampling times of samples with these timestamps, (k,)."""
        if self.sampling_delay_s is None:
            return time_s
        return time_s + np.interp(time_s, self.sample_times_s, self.sampling_delay_s)

    def with_delay(self, delay_s: FloatArray) -> Self:
        """Return the state with delayed instants, (instants,)."""
        return replace(self, sampling_delay_s=_sum_of_changes(self.sampling_delay_s, delay_s))

    def at_stage(self) -> Self:
        """Return a state in which every interval of the stage's rate is a block."""
        return replace(self.at_output(), gain=np.eye(3), low_pass=None)

    def at_sensor(self) -> Self:
        """Return a state in which every interval before the low-pass is a block."""
        return replace(self.at_output(), low_pass=None)

    def at_output(self) -> Self:
        """Return a state in which every interval after the low-pass is a block."""
        every = np.ones(self.interval_count, dtype=np.bool_)
        return replace(
            self,
            used_instants=every,
            instants_per_block=1,
            intervals_per_instant=1,
            lead_instants=0,
            sampling_delay_s=None,
        )

    def stage_rate_derivative(self, axis: int, change_rad: FloatArray) -> FloatArray:
        """Return the first-order rate change, (n, 3), by one axis' angles, shape (n + 1,)."""
        return self.axis_turn.rate(axis, change_rad, slice(0, self.interval_count))


def _sum_of_changes(previous: FloatArray | None, change: FloatArray) -> FloatArray:
    return change if previous is None else previous + change
