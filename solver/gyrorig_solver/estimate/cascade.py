"""Effects of several causes in series: each acts on the signal that earlier ones have changed.

The order is `model.term.SIGNAL_PATH`, from the motor command over gear, stage, mount, sensor and
low-pass to the timestamp. Backlash acts on the motion with rounded ramps, not on the commanded
motion, and a late clock delays the pulse of the backlash. Each effect is computed on a state that
earlier causes have changed. These effects add up to the exact total change.

What to use when: `total_effect` and `fitted_derivatives` in a fit, `effects_in_order` for the share
of each cause, `effect_of_removing` for the signal that some of them contribute; `TermCascade` for a
candidate in addition to the causes of a fit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.model import (
    SignalState,
    Stage,
    Term,
    term_label,
    value_parameters,
    zero_signals,
)
from gyrorig_solver.model.cause_categories import FILTER_STAGES, SIGNAL_PATH

CLIPPING_STAGES = ("threshold", "limit")  # stages that clip rates
FILTER_DERIVATIVE_STEP = 1e-3  # of a typical size


def order_by_stage(fitted_terms: Sequence[FittedTerm]) -> list[FittedTerm]:
    """Return causes in the order in which they act."""
    return sorted(fitted_terms, key=lambda fitted_term: _stage_order(fitted_term.term))


def effects_in_order(fitted_terms: Sequence[FittedTerm], state: SignalState) -> list[FloatArray]:
    """Return the share of each cause in the total effect, (blocks, 3) each, in the given order.

    The shares add up to the total effect. Causes that only filter or delay come first, because they
    act on the effects of all others. Some of these effects are computed after the filter and cannot
    be filtered again.
    """
    effects = {
        id(fitted_term): fitted_term.term.effect(input_state, fitted_term.values)
        for fitted_term, input_state in _input_states(fitted_terms, state)
    }
    zeros = zero_signals(state.block_count)
    return [effects.get(id(fitted_term), zeros) for fitted_term in fitted_terms]


def _input_states(
    fitted_terms: Sequence[FittedTerm], state: SignalState
) -> Iterator[tuple[FittedTerm, SignalState]]:
    """Yield each active cause with the signal at its input."""
    active = _filters_first(
        [fitted_term for fitted_term in order_by_stage(fitted_terms) if fitted_term.is_active]
    )
    for k, fitted_term in enumerate(active):
        yield fitted_term, state
        if k + 1 < len(active):
            state = fitted_term.term.propagate(state, fitted_term.values)


def _filters_first(active: list[FittedTerm]) -> list[FittedTerm]:
    filters = [fitted_term for fitted_term in active if fitted_term.term.stage in FILTER_STAGES]
    return [
        *filters,
        *(fitted_term for fitted_term in active if fitted_term.term.stage not in FILTER_STAGES),
    ]


def total_effect(fitted_terms: Sequence[FittedTerm], state: SignalState) -> FloatArray:
    """Return the total change by all causes, (blocks, 3), sensor frame."""
    total = zero_signals(state.block_count)
    for effect in effects_in_order(fitted_terms, state):
        total += effect
    return total


def effect_and_mask(
    fitted_terms: Sequence[FittedTerm], state: SignalState
) -> tuple[FloatArray, BoolArray | None]:
    """Return the total effect, and which blocks the fit leaves out because of the causes.

    The mask has the shape (blocks,); None leaves out nothing.
    """
    total = zero_signals(state.block_count)
    masks = []
    for fitted_term, input_state in _input_states(fitted_terms, state):
        total += fitted_term.term.effect(input_state, fitted_term.values)
        masks.append(fitted_term.term.timing_sensitive_mask(input_state, fitted_term.values))
    used_masks = [mask for mask in masks if mask is not None]
    return total, np.logical_or.reduce(used_masks) if used_masks else None


def effect_of_removing(
    removed: Sequence[FittedTerm], fitted_terms: Sequence[FittedTerm], state: SignalState
) -> FloatArray:
    """Return the effect that is lost if some causes are removed, (blocks, 3).

    Args:
        removed: the causes to remove.
        fitted_terms: all causes.
        state: the signal without any cause.
    """
    active = _filters_first(
        [fitted_term for fitted_term in order_by_stage(fitted_terms) if fitted_term.is_active]
    )
    is_kept = [all(fitted_term is not other for other in removed) for fitted_term in active]
    if all(is_kept):
        return zero_signals(state.block_count)
    first = is_kept.index(False)
    # these have the same effect with and without the removed causes
    for fitted_term in active[:first]:
        state = fitted_term.term.propagate(state, fitted_term.values)
    remaining = [fitted_term for fitted_term, stay in zip(active, is_kept, strict=True) if stay][
        first:
    ]
    return total_effect(active[first:], state) - total_effect(remaining, state)


def fitted_derivatives(fitted_terms: Sequence[FittedTerm], state: SignalState) -> FloatArray:
    """Return the derivatives by all fitted values, (k, blocks, 3).

    The derivatives are of first order: they neglect the change of the effects of later causes, with
    two exceptions. The first are causes that filter, delay or clip. The second is a gap: when the
    motor has crossed it, the stage starts immediately, and the effects of its acceleration depend
    on the time.
    """
    cascade = TermCascade(fitted_terms, state)
    derivatives = []
    for fitted_term in fitted_terms:
        if fitted_term.free_indices.size:
            jacobian = fitted_term.term.local_jacobian(
                cascade.state_before(fitted_term.term), fitted_term.values
            )[fitted_term.free_indices]
            if fitted_term.term.stage in FILTER_STAGES:
                jacobian = jacobian + cascade.off_grid_derivatives(fitted_term)
            elif fitted_term.term.stage == "play":
                jacobian = jacobian + cascade.later_derivatives(fitted_term)
            derivatives.append(cascade.apply_pass_through(fitted_term.term, jacobian))
    return np.concatenate(derivatives) if derivatives else zero_signals(0, state.block_count)


@dataclass(frozen=True, slots=True, eq=False)
class PassThrough:
    """The share of a small change that passes the clipping causes (incremental gain).

    A rate below a threshold or beyond a limit does not reach the output, and a small change of it
    does not either. Without this share, a fit would treat the rate as measured.
    """

    before_threshold: FloatArray  # (blocks, 3), for changes before the threshold
    after_threshold: FloatArray  # (blocks, 3), for changes after the threshold
    # (3, 3, blocks), derivative of the causes' effect by a row of G: axis, entry.
    gain_derivative: FloatArray

    def at_stage(self, stage: Stage) -> FloatArray | None:
        """Return the share that passes for a cause at a stage, (blocks, 3); None: everything."""
        position = SIGNAL_PATH.index(stage)
        if position < SIGNAL_PATH.index("threshold"):
            return self.before_threshold
        return self.after_threshold if position < SIGNAL_PATH.index("limit") else None


def pass_through_of(fitted_terms: Sequence[FittedTerm], state: SignalState) -> PassThrough | None:
    """Return the pass-through of the clipping causes, or None without any."""
    return TermCascade(fitted_terms, state).pass_through


class TermCascade:
    """One part of a series with the causes of a fit applied; states are cached."""

    def __init__(self, fitted_terms: Sequence[FittedTerm], state: SignalState) -> None:
        """Start from the causes and the state without them."""
        self.state = state
        self._active_terms = [
            fitted_term for fitted_term in order_by_stage(fitted_terms) if fitted_term.is_active
        ]
        self._states: dict[tuple[int, tuple[str, ...]], SignalState] = {}
        self._effects: dict[str, FloatArray] = {}

    def state_before(self, term: Term, excluding: str = "") -> SignalState:
        """Return the signal at a term's input: earlier causes, and all filters and delays.

        If the term is among the causes of the fit, it is left out, and so is the term `excluding`.
        """
        if not self._active_terms:
            return self.state
        upstream = [
            fitted_term
            for fitted_term in self._active_terms
            if _stage_order(fitted_term.term) < _stage_order(term)
        ]
        upstream_signals = [
            fitted_term for fitted_term in upstream if fitted_term.term.stage not in FILTER_STAGES
        ]
        filters = [
            fitted_term
            for fitted_term in self._active_terms
            if fitted_term.term.stage in FILTER_STAGES
            and term_label(fitted_term.term) not in (term_label(term), excluding)
        ]
        return self._state_after(upstream_signals, filters)

    @cached_property
    def pass_through(self) -> PassThrough | None:
        """The pass-through of the clipping causes; None without any."""
        after_threshold = np.ones((self.state.block_count, 3))
        before_threshold, gain = after_threshold, np.zeros((3, 3, self.state.block_count))
        clips = False
        for fitted_term in self._active_terms:
            state = (
                self.state_before(fitted_term.term)
                if fitted_term.term.stage in CLIPPING_STAGES
                else self.state
            )
            incremental_gain = fitted_term.term.incremental_gain(state, fitted_term.values)
            if incremental_gain is None:
                continue
            clips = True
            if fitted_term.term.stage == "limit":
                share = state.sample_output(incremental_gain)
                gain = share.T[:, None] * (gain + self._stage_rate) - self._stage_rate
                before_threshold, after_threshold = (
                    before_threshold * share,
                    after_threshold * share,
                )
                continue
            blocked = np.moveaxis(
                state.rate_rad_s[:, :, None] * (incremental_gain - 1.0)[:, None, :], 1, 0
            )
            gain = gain + state.measure_sensor_rate(blocked).transpose(2, 0, 1)
            before_threshold = before_threshold + state.measure_sensor_rate(incremental_gain - 1.0)
        return PassThrough(before_threshold, after_threshold, gain) if clips else None

    @cached_property
    def _stage_rate(self) -> FloatArray:
        """The stage's rates in the block means, (3, blocks)."""
        return self.state.measure_sensor_rate(self.state.rate_rad_s).T

    def apply_pass_through(self, term: Term, derivatives: FloatArray) -> FloatArray:
        """Return the share of a term's derivatives, (k, blocks, 3), that passes."""
        share = None if self.pass_through is None else self.pass_through.at_stage(term.stage)
        return derivatives if share is None or term.ignores_clipping else derivatives * share

    def joint_effect(self, term: Term, values: FloatArray) -> FloatArray:
        """Return the change of the joint effect of all causes by a term, (blocks, 3).

        Effects on later causes count if they are larger than a product of two small effects.
        """
        state = self.state_before(term)
        total = term.effect(state, values)
        if term.stage in FILTER_STAGES:
            total = total + self._off_grid_effect(term, values) - self._off_grid_effect(term, None)
        downstream = [
            downstream_term
            for downstream_term in self._active_terms
            if _stage_order(downstream_term.term) > _stage_order(term)
        ]
        downstream = [
            downstream_term
            for downstream_term in downstream
            if downstream_term.term.stage not in FILTER_STAGES
        ]
        last_dependent = max(
            (
                k
                for k, downstream_term in enumerate(downstream)
                if downstream_term.term.depends_on_upstream
            ),
            default=-1,
        )
        if last_dependent < 0:
            return total
        changed_state = term.propagate(state, values)
        for k, downstream_term in enumerate(downstream[: last_dependent + 1]):
            if downstream_term.term.depends_on_upstream:
                total = (
                    total
                    + downstream_term.term.effect(changed_state, downstream_term.values)
                    - self._effect_of_term(downstream_term)
                )
            if k < last_dependent:
                changed_state = downstream_term.term.propagate(
                    changed_state, downstream_term.values
                )
        return total

    def off_grid_derivatives(self, filter_term: FittedTerm) -> FloatArray:
        """Return a filter's derivatives of the off-grid effects, (free, blocks, 3)."""
        derivatives = zero_signals(filter_term.free_indices.size, self.state.block_count)
        if not any(self._off_grid_terms(filter_term.term)):
            return derivatives
        parameters = value_parameters(filter_term.term)
        for k, index in enumerate(filter_term.free_indices):
            step = np.zeros(filter_term.values.size)
            step[index] = FILTER_DERIVATIVE_STEP * parameters[index].typical_size
            upper, lower = (
                self._off_grid_effect(filter_term.term, filter_term.values + by)
                for by in (step, -step)
            )
            derivatives[k] = (upper - lower) / (2.0 * step[index])
        return derivatives

    def later_derivatives(self, fitted_term: FittedTerm) -> FloatArray:
        """Return the derivatives of the effects that later causes of the stage have on angles.

        They are central differences with the steps of the cause, (free, blocks, 3).
        """
        derivatives = zero_signals(fitted_term.free_indices.size, self.state.block_count)
        later_terms = [
            later
            for later in self._active_terms
            if _stage_order(later.term) > _stage_order(fitted_term.term)
            and later.term.needs_angles
            and later.term.depends_on_upstream
            and later.term.stage not in FILTER_STAGES
        ]
        if not later_terms:
            return derivatives
        for k, index in enumerate(fitted_term.free_indices):
            upper, lower, width = fitted_term.term.difference_values(fitted_term.values, int(index))
            states = [
                fitted_term.term.propagate(self.state_before(fitted_term.term), values)
                for values in (upper, lower)
            ]
            for later in later_terms:
                high, low = (later.term.effect(state, later.values) for state in states)
                derivatives[k] += (high - low) / width
        return derivatives

    def _off_grid_terms(self, filter_term: Term) -> Iterator[tuple[FittedTerm, SignalState]]:
        """Yield the causes with an off-grid effect, and their states without a filter."""
        for fitted_term in self._active_terms:
            if fitted_term.term.stage not in FILTER_STAGES:
                state = self.state_before(fitted_term.term, excluding=term_label(filter_term))
                if fitted_term.term.off_grid_effect(state, fitted_term.values) is not None:
                    yield fitted_term, state

    def _off_grid_effect(self, filter_term: Term, values: FloatArray | None) -> FloatArray:
        """Return all off-grid effects after a filter or delay; `values` None: without it."""
        total = zero_signals(self.state.block_count)
        for fitted_term, state in self._off_grid_terms(filter_term):
            filtered_state = state if values is None else filter_term.propagate(state, values)
            effect = fitted_term.term.off_grid_effect(filtered_state, fitted_term.values)
            total += 0.0 if effect is None else effect
        return total

    def clear_cache(self) -> None:
        """Remove the cached states."""
        self._states.clear()

    def _effect_of_term(self, fitted_term: FittedTerm) -> FloatArray:
        """Return the effect of a cause of the fit, without the candidate."""
        name = term_label(fitted_term.term)
        if name not in self._effects:
            self._effects[name] = fitted_term.term.effect(
                self.state_before(fitted_term.term), fitted_term.values
            )
        return self._effects[name]

    def _state_after(self, signals: list[FittedTerm], filters: list[FittedTerm]) -> SignalState:
        key = len(signals), tuple(term_label(filter_term.term) for filter_term in filters)
        if key not in self._states:
            if signals:
                last = signals[-1]
                state = last.term.propagate(self._state_after(signals[:-1], filters), last.values)
            else:
                state = self.state
                for filter_term in filters:
                    state = filter_term.term.propagate(state, filter_term.values)
            self._states[key] = state
        return self._states[key]


def _stage_order(term: Term) -> tuple[int, str]:
    return SIGNAL_PATH.index(term.stage), term_label(term)
