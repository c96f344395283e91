"""Jumps of an axis' speed, and their responses after the low-pass.

A stepper starts and stops at its base speed immediately. An effect proportional to its acceleration
then makes two opposite pulses at the same time. A sample that is taken while the filter starts to
respond depends on their order, and a grid of milliseconds cannot represent that. This module uses
the analytic response of the filter, a second-order Butterworth.

What to use when: `find_speed_jumps` for times and sizes; `angle_of_jumps` for their part of an
angle on the grid; `jump_responses` for their signal in the block means.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.reference import MotionProfile

MAX_RELATIVE_DEVIATION = 0.3  # of a jump; with a larger deviation, the angle does not show the jump
MEMORY_TIME_CONSTANTS = 12.0  # of the filter
MIN_GAP_RAD = 1e-6  # a motor crosses a smaller gap in microseconds
MAX_CROSSING_INTERVALS = 256  # of the grid, while the motor crosses a gap
NEWTON_STEPS = 3
START_TIME_ERROR_S = 3e-4  # two or three standard deviations of a fitted start time
CROSSING_TIME_ERROR_S = 1e-3  # upper limit for the end of a gap: 1e-4 rad at 0.1 rad/s


Jump = tuple[float, float, float]  # time in s, size in rad/s, error of the time in s


@dataclass(frozen=True, slots=True)
class SpeedJumps:
    """The jumps of an axis' speed, (j,) each."""

    time_s: FloatArray
    size_rad_s: FloatArray
    time_error_s: FloatArray  # largest possible difference between the true and the fitted time


def find_speed_jumps(state: SignalState, axis: int) -> SpeedJumps:
    """Return the jumps of an axis' speed.

    The result has only jumps that the angles show: an earlier cause can have rounded the ramps.
    With a gap, the stage starts after the motor has crossed it, at the speed of the motor at that
    time.
    """
    jumps: list[Jump] = []
    resolution = state.context.rad_per_step
    for moved_axis, profile in state.context.motion_profiles if resolution is not None else ():
        if moved_axis != axis or resolution is None:
            continue
        move = _Move(state, axis, profile, resolution[axis])
        start_jump = move.start_jump()
        jumps += [] if start_jump is None else [start_jump]
        jumps += move.later_jumps()
    return SpeedJumps(*np.array(jumps, dtype=np.float64).reshape(-1, 3).T)


@dataclass(frozen=True, slots=True)
class _Move:
    """A move of the motor, compared with the angle of the stage."""

    state: SignalState
    axis: int
    profile: MotionProfile
    rad_per_step: float

    def start_jump(self) -> Jump | None:
        """Return the jump when the stage starts; None if the angle of the stage shows none."""
        edges_s, start_s = self.state.edges_s, float(self.profile.start_s[0])
        k = int(np.searchsorted(edges_s, start_s, side="right")) - 1
        if not 1 <= k < edges_s.size - 2:
            return None
        start_speed = float(self.profile.start_speed_steps_s[0]) * self.rad_per_step
        has_jump = start_speed != 0.0 and self._has_jump(k, start_speed)
        at_start = (start_s, start_speed, START_TIME_ERROR_S) if has_jump else None
        motor, stage = self._angles(slice(k - 1, k + 3))
        if abs((motor[-1] - motor[0]) - (stage[-1] - stage[0])) < MIN_GAP_RAD:
            return at_start
        window = slice(k - 1, min(k + MAX_CROSSING_INTERVALS, edges_s.size))
        motor, stage = self._angles(window)
        width = np.diff(edges_s[window])
        motor_rate, stage_rate = np.diff(motor) / width, np.diff(stage) / width
        limit = MAX_RELATIVE_DEVIATION * np.abs(motor_rate)
        is_following = (np.abs(stage_rate - motor_rate) <= limit) & (limit > 0.0)
        # The stage starts in this interval or in the previous one, and follows at its end.
        first = int(np.argmax(is_following))
        if first < 2 or abs(stage_rate[first - 2]) > limit[first - 2]:
            return at_start
        after = first + 1
        crossed_rad = float(motor[after] - motor[0] - (stage[after] - stage[0]))
        return self._jump_behind_gap(float(edges_s[window][first]), motor[0] + crossed_rad)

    def _jump_behind_gap(self, guess_s: float, motor_rad: float) -> Jump:
        """Return the jump of a stage that starts when the motor is at an angle."""
        time_s, start_s = guess_s, float(self.profile.start_s[0])
        for _ in range(NEWTON_STEPS):
            steps, speed_steps_s, _ = self.profile.state_at(time_s)
            if speed_steps_s == 0.0:
                break
            time_s -= (steps - motor_rad / self.rad_per_step) / speed_steps_s
            time_s = max(time_s, start_s)
        speed = self.profile.state_at(time_s)[1] * self.rad_per_step
        # An angle error that grows with the motion looks like a very small gap.
        time_error_s = min(CROSSING_TIME_ERROR_S, START_TIME_ERROR_S + time_s - start_s)
        return time_s, speed, time_error_s

    def later_jumps(self) -> Iterator[Jump]:
        """Yield the jumps after the start."""
        profile, edges_s = self.profile, self.state.edges_s
        length = np.diff(profile.start_s)
        speed_before = (
            profile.start_speed_steps_s[:-1] + profile.acceleration_steps_s2[:-1] * length
        )
        sizes = self.rad_per_step * (profile.start_speed_steps_s[1:] - speed_before)
        for jump_s, size in zip(profile.start_s[1:].tolist(), sizes.tolist(), strict=True):
            k = int(np.searchsorted(edges_s, jump_s, side="right")) - 1
            if size == 0.0 or not 1 <= k < edges_s.size - 2:
                continue
            if self._has_jump(k, size):
                yield jump_s, size, START_TIME_ERROR_S

    def _has_jump(self, k: int, size_rad_s: float) -> bool:
        """Return whether the angle of the stage shows a jump of the motor after edge k."""
        window = slice(k - 1, k + 3)
        motor, stage = self._angles(window)
        rate_deviation = np.diff(stage - motor) / np.diff(self.state.edges_s[window])
        change = abs(float(rate_deviation[-1] - rate_deviation[0]))
        return change < MAX_RELATIVE_DEVIATION * abs(size_rad_s)

    def _angles(self, window: slice) -> tuple[FloatArray, FloatArray]:
        """Return the commanded angle and the angle of the stage at some edges, (m,) each."""
        motor = self.profile.position_steps(self.state.edges_s[window]) * self.rad_per_step
        return motor, self.state.angle_rad[self.axis, window]


def angle_of_jumps(edges_s: FloatArray, jumps: SpeedJumps) -> FloatArray:
    """Return the part of an angle that comes from the speed jumps, at the edges, (n + 1,)."""
    if not jumps.time_s.size:
        return np.zeros_like(edges_s)
    order = np.argsort(jumps.time_s, kind="stable")
    jump_s, speed = jumps.time_s[order], np.cumsum(jumps.size_rad_s[order])
    at_jump = np.concatenate([[0.0], np.cumsum(speed[:-1] * np.diff(jump_s))])
    last = np.searchsorted(jump_s, edges_s, side="right") - 1
    angle = at_jump[last] + speed[last] * (edges_s - jump_s[last])
    return np.where(last >= 0, angle, 0.0)


def jump_responses(state: SignalState, axis: int, jumps: SpeedJumps) -> FloatArray:
    """Return the change of the block means by the acceleration of the jumps, (blocks, 3).

    The rate is size x delta'(t - time) about the axis, after the sensor's low-pass.
    """
    return _responses(
        state,
        axis,
        jumps.time_s,
        jumps.size_rad_s,
        lambda x, omega: omega**2 * np.exp(-x) * (np.cos(x) - np.sin(x)),
    )


def pulse_response(state: SignalState, axis: int, time_s: float) -> FloatArray:
    """Return the change of the block means by a pulse of 1 rad about an axis, (blocks, 3).

    The rate is delta(t - time) about the axis, after the sensor's low-pass.
    """
    return _responses(
        state,
        axis,
        np.array([time_s]),
        np.ones(1),
        lambda x, omega: np.sqrt(2.0) * omega * np.exp(-x) * np.sin(x),
    )


def _responses(
    state: SignalState,
    axis: int,
    time_s: FloatArray,
    sizes: FloatArray,
    response_at: Callable[[FloatArray, float], FloatArray],
) -> FloatArray:
    """Return the block means of responses of the low-pass about an axis, (blocks, 3).

    Args:
        state: the signal.
        axis: 0 pan, 1 tilt.
        time_s: the begin of each response, (k,).
        sizes: of the responses, (k,).
        response_at: the response per size at a phase in rad, for the angular cut-off frequency.
    """
    signal = np.zeros((state.used_instants.size, 3))
    if state.low_pass is None:
        return state.block_means(signal)
    omega = 2.0 * np.pi * state.low_pass.bandwidth_hz
    tilt = np.interp(time_s, state.edges_s, state.angle_rad[1])
    ones, zeros = np.ones_like(tilt), np.zeros_like(tilt)
    direction = [zeros, np.sin(tilt), np.cos(tilt)] if axis == 0 else [ones, zeros, zeros]
    sensor_direction = np.stack(direction, axis=1) @ state.gain.T
    reach_s = MEMORY_TIME_CONSTANTS * np.sqrt(2.0) / omega
    # A delayed sample shows later motion.
    sampling_times_s = state.sample_times_s + (
        0.0 if state.sampling_delay_s is None else state.sampling_delay_s
    )
    first = np.searchsorted(sampling_times_s, time_s, side="right")
    stop = np.searchsorted(sampling_times_s, time_s + reach_s)
    for k, (begin, end) in enumerate(zip(first.tolist(), stop.tolist(), strict=True)):
        x = (sampling_times_s[begin:end] - time_s[k]) * (omega / np.sqrt(2.0))
        response = sizes[k] * response_at(x, omega)
        signal[begin:end] += response[:, None] * sensor_direction[k]
    return state.block_means(signal)
