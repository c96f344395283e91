"""Jumps of an axis' speed, and their responses behind the low-pass.

A stepper starts and stops at its base speed immediately. An effect proportional to its acceleration
then makes two opposite pulses at the same time. A sample that is taken while the filter starts to
respond depends on their order, and a grid of milliseconds cannot represent that. This module uses
the analytic response of the filter, a second-order Butterworth.

What to use when: `find_speed_jumps` for times and sizes; `angle_of_jumps` for their part of an
angle on the grid; `jump_responses` for their signal in the block means.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_state import SignalState

MAX_RELATIVE_DEVIATION = 0.3  # of a jump: with a larger deviation the angle does not have the jump
MEMORY_TIME_CONSTANTS = 12.0  # of the filter


def find_speed_jumps(state: SignalState, axis: int) -> tuple[FloatArray, FloatArray]:
    """Return the times and sizes of an axis' speed jumps, s and rad/s, (j,) each.

    Only jumps that the angles show: an earlier cause can have rounded the ramps.
    """
    times, sizes = [], []
    resolution = state.context.rad_per_step
    edges_s, angle = state.edges_s, state.angle_rad[axis]
    for moved_axis, profile in state.context.motion_profiles if resolution is not None else ():
        if moved_axis != axis or resolution is None:
            continue
        length = np.diff(profile.start_s)
        end_speed = np.append(
            0.0, profile.start_speed_steps_s[:-1] + profile.acceleration_steps_s2[:-1] * length
        )
        for jump_s, jump in zip(
            profile.start_s, profile.start_speed_steps_s - end_speed, strict=True
        ):
            k = int(np.searchsorted(edges_s, jump_s, side="right")) - 1
            if jump == 0.0 or not 1 <= k < edges_s.size - 2:
                continue
            window = slice(k - 1, k + 3)
            commanded = profile.position_steps(edges_s[window]) * resolution[axis]
            rate_deviation = np.diff(angle[window] - commanded) / np.diff(edges_s[window])
            if abs(rate_deviation[-1] - rate_deviation[0]) < MAX_RELATIVE_DEVIATION * abs(
                jump * resolution[axis]
            ):
                times.append(float(jump_s))
                sizes.append(float(jump) * resolution[axis])
    return np.array(times, dtype=np.float64), np.array(sizes, dtype=np.float64)


def angle_of_jumps(edges_s: FloatArray, time_s: FloatArray, size_rad_s: FloatArray) -> FloatArray:
    """Return the part of an angle that the speed jumps make, at the edges, (n + 1,)."""
    if not time_s.size:
        return np.zeros_like(edges_s)
    order = np.argsort(time_s, kind="stable")
    jump_s, speed = time_s[order], np.cumsum(size_rad_s[order])
    at_jump = np.concatenate([[0.0], np.cumsum(speed[:-1] * np.diff(jump_s))])
    last = np.searchsorted(jump_s, edges_s, side="right") - 1
    angle = at_jump[last] + speed[last] * (edges_s - jump_s[last])
    return np.where(last >= 0, angle, 0.0)


def jump_responses(
    state: SignalState, axis: int, time_s: FloatArray, size_rad_s: FloatArray
) -> FloatArray:
    """Return the change of the block means by the acceleration of the jumps, (blocks, 3).

    The rate is size x delta'(t - time) about the axis, behind the sensor's low-pass.
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
    # A delayed sample has seen later motion.
    sampling_times_s = state.sample_times_s + (
        0.0 if state.sampling_delay_s is None else state.sampling_delay_s
    )
    first = np.searchsorted(sampling_times_s, time_s, side="right")
    stop = np.searchsorted(sampling_times_s, time_s + reach_s)
    for k, (begin, end) in enumerate(zip(first.tolist(), stop.tolist(), strict=True)):
        x = (sampling_times_s[begin:end] - time_s[k]) * (omega / np.sqrt(2.0))
        response = size_rad_s[k] * omega**2 * np.exp(-x) * (np.cos(x) - np.sin(x))
        signal[begin:end] += response[:, None] * sensor_direction[k]
    return state.block_means(signal)
