"""Lost steps: the motor loses steps in a move, so that count and angle differ afterwards.

angle - s from the event on, all at once. The rotor falls back by whole cycles of four full steps,
0.411 deg on a PTU-E46-17.5 (0.1029 deg per full step). High speed, acceleration or load, and low
move power or supply voltage cause it. The rate has one short pulse, and every later angle is wrong.

The pulse is shorter than an interval of the grid, so that the effect contains the response of the
low-pass in closed form. The low-pass determines the length of the pulse in the samples, so the
search must try every time. The template bank contains a limited number of times. `pulse_templates`
has the signal of every time, which the search correlates with a residual; the search starts at the
best of these times.
"""

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.model.signal_arrays import zero_signals
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.speed_jumps import pulse_response
from gyrorig_solver.model.term import EVENT_TIME, PulseTemplates, size_parameter
from gyrorig_solver.model.term_kinds import LinearAngleTerm, scan_grid
from gyrorig_solver.model.value_format import DEG, PAN_TILT, format_list

SCAN_SPACING_S = 0.02  # of the times in the bank; about the width of a pulse
MAX_SCAN_TIMES = 2000
# Before a search has found the motion law, such as an S-curve, a move can begin this much earlier
# than its prediction. After a move, the noise of the motor passes the low-pass and looks like a
# small loss in the quiet of a rest.
START_MARGIN_S = 0.04


def pulse_templates(state: SignalState, times_per_block: int = 2) -> PulseTemplates:
    """Return the templates of step losses in the moves of each axis and shortly before.

    They contain neither the remaining lean after a loss on tilt nor missing samples.

    Args:
        state: a part of a series.
        times_per_block: number of times per block.
    """
    intervals_per_block = state.intervals_per_instant * state.instants_per_block
    stride = max(1, intervals_per_block // times_per_block)
    step_s = state.step_s
    settling_intervals = (
        0 if state.low_pass is None else int(3.0 / state.low_pass.bandwidth_hz / step_s)
    )
    pulse_blocks = 1 + -(-(settling_intervals + intervals_per_block) // intervals_per_block)
    phases = range(0, intervals_per_block, stride)
    impulses = np.zeros(
        (len(phases), pulse_blocks * intervals_per_block + 2, 1)
    )  # two more intervals before, at rest
    for row, phase in enumerate(phases):
        impulses[row, phase + 1 : phase + 4, 0] = np.array([1.0, 22.0, 1.0]) / 24.0 / step_s
    filtered = state.low_pass_filtered(impulses)[
        :, 2 + state.intervals_per_instant // 2 :: state.intervals_per_instant, 0
    ][:, : pulse_blocks * state.instants_per_block]
    kernel = filtered.reshape(len(phases), pulse_blocks, state.instants_per_block).mean(axis=2)
    lead_intervals = state.lead_instants * state.intervals_per_instant
    axis_templates = []
    for axis in (0, 1):
        intervals = np.arange(lead_intervals, state.interval_count, stride)
        is_possible = _turning_soon(state, axis) & state.motion_known
        intervals = intervals[is_possible[intervals]]
        first_blocks = (intervals - lead_intervals) // intervals_per_block
        intervals = intervals[first_blocks + pulse_blocks <= state.block_count]
        first_blocks = first_blocks[first_blocks + pulse_blocks <= state.block_count]
        direction = np.zeros((intervals.size, 3))
        if axis == 0:
            direction[:, 1] = np.sin(state.tilt_rad[intervals])
            direction[:, 2] = np.cos(state.tilt_rad[intervals])
        else:
            direction[:, 0] = 1.0
        responses = kernel[((intervals - lead_intervals) % intervals_per_block) // stride]
        values = -responses[:, :, None] * (direction @ state.gain.T)[:, None, :]
        axis_templates.append(
            (state.time_s[intervals], np.full(intervals.size, axis), first_blocks, values)
        )
    time_s, axis_index, all_first_blocks, values = (
        np.concatenate(part) for part in zip(*axis_templates, strict=True)
    )
    return PulseTemplates(time_s, axis_index, all_first_blocks, values)


def _turning_soon(state: SignalState, axis: int) -> BoolArray:
    """Return when an axis turns, or can turn if its motion law is not known, (n,)."""
    margin = round(START_MARGIN_S / state.step_s)
    total = np.concatenate([[0], np.cumsum(np.pad(state.moving[axis], (0, margin)))])
    return np.asarray(total[margin + 1 :] > total[: -margin - 1], dtype=np.bool_)


def _turns_soon(state: SignalState, axis: int, k: int) -> bool:
    """Return the same for one interval."""
    margin = round(START_MARGIN_S / state.step_s)
    return bool(state.moving[axis, k : k + margin + 1].any())


class LostSteps(LinearAngleTerm):
    """The lost angle of pan and tilt, then the time."""

    cause = "lost_steps"
    title = "The motor lost steps"
    equation = "angle = angle - angle lost for t >= time"
    stage = "rotor"
    scope = "recording"
    parameters = (
        size_parameter(
            "angle", "rad", PAN_TILT, typical=0.411, limit=10.0, prior_std=2.0, factor=DEG
        ),
        EVENT_TIME,
    )
    confused_with = ("backlash", "clock_step", "board_slip")
    remedy = (
        "lower the acceleration or the load, check the gear for obstacles, and home the unit again"
    )
    covariates = None
    picture = None
    template_search = "pulses"
    is_whole_steps = True
    excitation = "a return to the first poses at the end, and a second homing"
    effect_if_ignored = (
        "small if pan lost steps; if tilt lost steps, the misalignment M is a mean of two mount "
        "angles"
    )

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the change of the measured rate, (blocks, 3)."""
        return super().effect(state, values) + self.off_grid_effect(state, values)

    def off_grid_effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the exact form of the pulse minus that on the grid, (blocks, 3)."""
        effect = zero_signals(state.block_count)
        for axis in np.flatnonzero(values[:2]):
            effect += values[axis] * self._off_grid_signal(state, int(axis), float(values[2]))
        return effect

    def _effect_difference(
        self, state: SignalState, upper: FloatArray, lower: FloatArray
    ) -> FloatArray:
        """Return the difference of two effects, (blocks, 3)."""
        off_grid = self.off_grid_effect(state, upper) - self.off_grid_effect(state, lower)
        return super()._effect_difference(state, upper, lower) + off_grid

    def _off_grid_signal(self, state: SignalState, axis: int, event_s: float) -> FloatArray:
        """Return the pulse of a loss of 1 rad minus that on the grid, (blocks, 3)."""
        k = self._event_interval(state, event_s)
        if state.low_pass is None or not 1 <= k < state.interval_count - 2:
            return zero_signals(state.block_count)
        tilt_rad = float(np.interp(event_s, state.edges_s, state.angle_rad[1]))
        direction = [0.0, np.sin(tilt_rad), np.cos(tilt_rad)] if axis == 0 else [1.0, 0.0, 0.0]
        pulse = np.outer(self._pulse_weights(state, k, event_s) / state.step_s, direction)
        return _measure_pulse(state, k - 1, pulse) - pulse_response(state, axis, event_s)

    def angle_shapes(self, state: SignalState, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return minus the step at the event."""
        k = self._event_interval(state, float(values[2]))
        shape = np.zeros(state.interval_count + 1)
        shape[max(0, k + 1) :] = -1.0
        if 1 <= k < state.interval_count - 2:
            shape[k : k + 4] = -np.cumsum(self._pulse_weights(state, k, float(values[2])))
        return [(0, shape), (1, shape)]

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan times over all moves."""
        moving = state.moving.any(axis=0) & state.motion_known
        stride = max(
            1, round(SCAN_SPACING_S / state.step_s), -(-int(moving.sum()) // MAX_SCAN_TIMES)
        )
        return scan_grid(self, time=state.time_s[moving][::stride])

    def tangent_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the derivatives by the sizes, zero for an axis that is at rest and stays so.

        On pan it is a pulse, which is fast to compute. On tilt, the remaining lean is included. The
        form of the pulse is that on the grid: a search scans times that are not exact.
        """
        signals = zero_signals(2, state.block_count)
        k = self._event_interval(state, float(values[2]))
        if not 1 <= k < state.interval_count - 2:
            return signals
        pan_turns, tilt_turns = (_turns_soon(state, axis, k) for axis in (0, 1))
        if pan_turns:
            angle_loss = np.cumsum([0.0, *self._pulse_weights(state, k, float(values[2]))])
            pulse = state.axis_turn.rate(0, -angle_loss, slice(k - 1, k + 3))
            signals[0] = _measure_pulse(state, k - 1, pulse)
        if tilt_turns:
            shape = self.angle_shapes(state, values)[1][1]
            signals[1] = state.measure_stage_rate(state.stage_rate_derivative(1, shape))
        return signals

    def jacobian(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the derivatives by the values, (3, blocks, 3)."""
        jacobian = zero_signals(3, state.block_count)
        rates = [
            state.stage_rate_derivative(axis, s) for axis, s in self.angle_shapes(state, values)
        ]
        jacobian[:2] = state.measure_stage_rate(np.stack(rates))
        for axis in (0, 1):
            jacobian[axis] += self._off_grid_signal(state, axis, float(values[2]))
        if values[:2].any():
            jacobian[2] = self._finite_difference(state, values, 2)
        return jacobian

    def pulse_templates(self, state: SignalState) -> PulseTemplates:
        """Return the signal of a loss of 1 rad at each time of a move."""
        return pulse_templates(state)

    def describe(self, values: FloatArray) -> str:
        text = format_list(values[:2] / DEG, PAN_TILT, "deg")
        return f"the motors lost steps at {values[2]:.2f} s: {text}"

    def _event_interval(self, state: SignalState, event_s: float) -> int:
        """Return the last interval whose centre is before the event."""
        if event_s <= state.time_s[0]:
            return -1
        k = int(np.searchsorted(state.time_s, event_s, side="right")) - 1
        return (
            k
            if k < state.interval_count - 1 or event_s < state.edges_s[-1]
            else state.interval_count
        )

    def _pulse_weights(self, state: SignalState, k: int, event_s: float) -> FloatArray:
        """Return the weights of the pulse in the four intervals from `k - 1` on.

        The moments about the event are such that the low-pass reproduces the time and the width of
        the pulse. It treats the intervals as means of a smooth signal and sharpens them by h^2/4,
        while straight lines between them widen the pulse by h^2/6.
        """
        step = (state.time_s[k - 1 : k + 3] - event_s) / state.step_s
        moments = np.array([1.0, 0.0, 1.0 / 12.0, 0.0])
        return np.asarray(np.linalg.solve(np.vander(step, 4, increasing=True).T, moments))


def _measure_pulse(state: SignalState, first: int, stage_rate: FloatArray) -> FloatArray:
    """Return `measure_stage_rate` of a change that is zero except in a few intervals.

    Args:
        state: the signal.
        first: index of its first interval.
        stage_rate: shape (m, 3).
    """
    if state.sampling_delay_s is not None:
        padded = np.zeros((state.interval_count, 3))
        visible = padded[first : first + len(stage_rate)]
        visible[:] = stage_rate[: len(visible)]
        return state.measure_stage_rate(padded)
    result = np.zeros((state.block_count, 3))
    intervals_per_block = state.intervals_per_instant * state.instants_per_block
    settling_intervals = (
        0 if state.low_pass is None else int(3.0 / state.low_pass.bandwidth_hz / state.step_s)
    )
    lead_intervals = state.lead_instants * state.intervals_per_instant
    begin = max(0, (first - lead_intervals) // intervals_per_block)
    end = min(
        state.block_count,
        -((lead_intervals - first - len(stage_rate) - settling_intervals) // intervals_per_block),
    )
    if end <= begin:
        return result
    start = lead_intervals + begin * intervals_per_block
    window = np.zeros(
        ((end - begin) * intervals_per_block + 1, 3)
    )  # one more interval before, at rest
    skipped = max(0, start - first)
    visible = stage_rate[skipped:]
    position = first + skipped - start + 1
    visible = visible[: len(window) - position]
    is_known = state.motion_known[first + skipped : first + skipped + len(visible), None]
    window[position : position + len(visible)] = np.where(is_known, visible, 0.0) @ state.gain.T
    out = state.low_pass_filtered(window)[1:]
    used = state.used_instants[
        begin * state.instants_per_block : end * state.instants_per_block
    ].reshape(-1, state.instants_per_block, 1)
    values = out[state.intervals_per_instant // 2 :: state.intervals_per_instant].reshape(
        -1, state.instants_per_block, 3
    )
    total = np.where(used, values, 0.0).sum(axis=1)
    result[begin:end] = total / np.maximum(used.sum(axis=1), 1)
    return result


TERM = LostSteps()
