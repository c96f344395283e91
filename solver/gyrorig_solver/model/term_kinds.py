"""Base classes of the causes, so that the file of a cause contains only its physics.

What to use when: `LinearTerm` if the effect is a sum of sizes times signals at the sensor;
`AngleTerm` and `LinearAngleTerm` if the stage is not at the commanded angles; `TimeTerm` if the
samples were taken at other times; `NonlinearTerm` for any other effect; `ZeroMeanTerm` if the mean
of the series does not change.
"""

from abc import abstractmethod

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.cause_categories import Part, Scope, Stage
from gyrorig_solver.model.signal_arrays import stack_signals, zero_signals
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import Term, start_values, value_indices, value_parameters


class LinearTerm(Term):
    """A sum of sizes times basis signals, which can depend on shapes and events."""

    @abstractmethod
    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the signal of each size in the block means, (sizes, blocks, 3)."""

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the sum, shape (blocks, 3)."""
        # If the values of one axis are contiguous, the product needs no copy.
        rows = np.swapaxes(self.basis_signals(state, values), -1, -2)
        return np.swapaxes(np.tensordot(values[self.size_indices], rows, axes=1), -1, -2)

    def jacobian(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the basis signals, and finite differences by shapes and events, (k, blocks, 3)."""
        jacobian = zero_signals(values.size, state.block_count)
        jacobian[self.size_indices] = self.basis_signals(state, values)
        if values[self.size_indices].any():
            for k in value_indices(self, role="shape") + value_indices(self, role="event"):
                jacobian[k] = self._finite_difference(state, values, k)
        return jacobian

    def tangent_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the basis signals, (sizes, blocks, 3)."""
        return self.basis_signals(state, values)


class NonlinearTerm(Term):
    """Any effect; the search uses the effect at each finite size of the template bank."""

    def tangent_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the effect of each size alone, per unit of size, (sizes, blocks, 3).

        If the template has no size, the result is the derivative at size zero.
        """
        signals = []
        for k in self.size_indices:
            if values[k] == 0.0:
                signals.append(self._finite_difference(state, values, k))
                continue
            single_size = values.copy()
            single_size[[other for other in self.size_indices if other != k]] = 0.0
            signals.append(self.effect(state, single_size) / values[k])
        return stack_signals(signals)


class AngleTerm(NonlinearTerm):
    """A difference between the true and the commanded angles of the stage."""

    part: Part = "ptu"
    stage: Stage = "stage"
    needs_angles: bool = True
    depends_on_upstream: bool = True
    scope: Scope = "unit"

    @abstractmethod
    def angle_error(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return true minus commanded pan and tilt at the edges, (2, n + 1)."""

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the change of the measured rate by the angle error, (blocks, 3)."""
        return state.measure_stage_rate(state.stage_rate_change(self.angle_error(state, values)))

    def _effect_difference(
        self, state: SignalState, upper: FloatArray, lower: FloatArray
    ) -> FloatArray:
        """Return the difference of two effects, (blocks, 3), filtered once."""
        rates = [
            state.stage_rate_change(self.angle_error(state, values)) for values in (upper, lower)
        ]
        return state.measure_stage_rate(rates[0] - rates[1])

    def propagate(self, state: SignalState, values: FloatArray) -> SignalState:
        """Return the signal with the angle error applied."""
        return state.with_angles(self.angle_error(state, values))


class LinearAngleTerm(AngleTerm):
    """A sum of sizes times angle shapes; the derivatives are analytic, to first order."""

    depends_on_upstream: bool = False

    @abstractmethod
    def angle_shapes(self, state: SignalState, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return axis and angle change at the edges, (n + 1,), per unit of each size."""

    def angle_error(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the sum of the shapes, (2, n + 1)."""
        total = np.zeros_like(state.angle_rad)
        for size, (axis, shape) in zip(
            values[self.size_indices], self.angle_shapes(state, values), strict=True
        ):
            total[axis] += size * shape
        return total

    def jacobian(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the derivatives by the values, (k, blocks, 3)."""
        jacobian = zero_signals(values.size, state.block_count)
        jacobian[self.size_indices] = self.tangent_signals(state, values)
        if values[self.size_indices].any():
            for k in value_indices(self, role="shape") + value_indices(self, role="event"):
                jacobian[k] = self._finite_difference(state, values, k)
        return jacobian

    def tangent_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the derivatives by the sizes, (sizes, blocks, 3)."""
        rates = [
            state.stage_rate_derivative(axis, s) for axis, s in self.angle_shapes(state, values)
        ]
        return state.measure_stage_rate(stack_signals(rates))


class TimeTerm(NonlinearTerm):
    """A difference between sampling times and timestamps."""

    part: Part = "clock"
    stage: Stage = "clock"

    @abstractmethod
    def sampling_delay(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the sampling delay after each timestamp, s, (instants,)."""

    @abstractmethod
    def delay_derivatives(self, state: SignalState, values: FloatArray) -> dict[int, FloatArray]:
        """Return the analytic derivatives of the delay, by index of the value."""

    def propagate(self, state: SignalState, values: FloatArray) -> SignalState:
        """Return the signal with the delay applied."""
        return state.with_delay(self.sampling_delay(state, values))

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the change of the measured rate, (blocks, 3)."""
        delayed = state.sampled_output.at_delay(self.sampling_delay(state, values))
        return state.block_means(delayed - state.sampled_output.undelayed)

    def jacobian(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the time derivative of the signal times that of the delay, (k, blocks, 3)."""
        jacobian = zero_signals(values.size, state.block_count)
        slope = state.sampled_output.slope_at_delay(self.sampling_delay(state, values))
        analytic = self.delay_derivatives(state, values)
        for k in range(values.size):
            if k in analytic:
                jacobian[k] = state.block_means(slope * analytic[k][:, None])
            elif values[self.size_indices].any():
                jacobian[k] = self._finite_difference(state, values, k)
        return jacobian

    def tangent_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the derivatives by the sizes at size zero, otherwise as `NonlinearTerm`."""
        if values[self.size_indices].any():
            return super().tangent_signals(state, values)
        return self.jacobian(state, values)[self.size_indices]


class ZeroMeanTerm(Term):
    """Noise, or a fault of the raw stream: the mean of the series does not change."""

    stage: Stage = "readout"

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return zeros, shape (blocks, 3)."""
        return zero_signals(state.block_count)

    def jacobian(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return zeros, shape (k, blocks, 3)."""
        return zero_signals(values.size, state.block_count)


def event_times(state: SignalState, count: int) -> FloatArray:
    """Return `count` times spread over the recording, (count,), away from its ends."""
    begin, end = state.context.begin_s, state.context.end_s
    return np.asarray(begin + (end - begin) * (np.arange(count) + 0.5) / count, np.float64)


def step_signal(state: SignalState, event_s: float) -> FloatArray:
    """Return 0 before an event and 1 after it, (n,), with a fraction in its interval."""
    share = (state.edges_s[1:] - event_s) / state.axis_turn.width_s
    return np.clip(share, 0.0, 1.0)


def scan_grid(term: Term, **values: FloatArray) -> FloatArray:
    """Return a template bank over a full grid of some parameters; others have start values.

    Args:
        term: the cause.
        **values: by parameter name, shape (m,) each; all components get the same value.
    """
    parameter_names = [p.name for p in value_parameters(term)]
    grid = np.meshgrid(*values.values(), indexing="ij")
    rows = np.tile(start_values(term), (grid[0].size, 1))
    for name, column in zip(values, grid, strict=True):
        for k in (k for k, parameter_name in enumerate(parameter_names) if parameter_name == name):
            rows[:, k] = column.ravel()
    return rows
