"""Causes that act in one of several recordings, or several times in a recording.

A board or a unit has a cause in all its recordings. A bias step or a board slip occurs in one
recording. `limit_to_recording` makes a term whose effect is zero in all other recordings. A motor
can lose steps several times, and each loss is a term with its own size and time.

What to use when: `limit_to_recording` for a cause of scope `recording` if there are several
recordings; `occurrence_after` for a cause that a fit may contain already; `is_active_in` before
its template bank or its times are needed; `term_label` to distinguish the instances of a cause.
"""

from collections.abc import Set
from copy import copy
from functools import cache
from typing import Any

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_arrays import zero_signals
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import Term, value_names

MAX_OCCURRENCES = 3  # of one cause in a recording


class _OneRecordingMixin:
    """Mixin that precedes the class of a term and limits its methods to one recording."""

    recording_index: int

    def _is_own_recording(self, state: SignalState) -> bool:
        return state.context.recording_index == self.recording_index

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        parent: Any = super()
        if self._is_own_recording(state):
            return np.asarray(parent.effect(state, values), dtype=np.float64)
        return np.zeros((state.block_count, 3))

    def angle_error(self, state: SignalState, values: FloatArray) -> FloatArray:
        parent: Any = super()
        if self._is_own_recording(state):
            return np.asarray(parent.angle_error(state, values), dtype=np.float64)
        return np.zeros_like(state.angle_rad)

    def sampling_delay(self, state: SignalState, values: FloatArray) -> FloatArray:
        parent: Any = super()
        if self._is_own_recording(state):
            return np.asarray(parent.sampling_delay(state, values), dtype=np.float64)
        return np.zeros(state.used_instants.size)

    def propagate(self, state: SignalState, values: FloatArray) -> SignalState:
        parent: Any = super()
        propagated: SignalState = (
            parent.propagate(state, values) if self._is_own_recording(state) else state
        )
        return propagated

    def jacobian(self, state: SignalState, values: FloatArray) -> FloatArray:
        parent: Any = super()
        if self._is_own_recording(state):
            return np.asarray(parent.jacobian(state, values), dtype=np.float64)
        return zero_signals(values.size, state.block_count)

    def tangent_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        parent: Any = super()
        if self._is_own_recording(state):
            return np.asarray(parent.tangent_signals(state, values), dtype=np.float64)
        return zero_signals(len(parent.size_indices), state.block_count)

    def template_bank(self, state: SignalState) -> FloatArray:
        parent: Any = super()
        rows = np.asarray(parent.template_bank(state), dtype=np.float64)
        return rows if self._is_own_recording(state) else rows[:0]


def limit_to_recording(term: Term, recording_index: int) -> Term:
    """Return a cause that acts in one recording only."""
    limited: Any = object.__new__(_one_recording_class(type(term)))
    limited.__dict__.update(term.__dict__)
    limited.recording_index = recording_index
    term_of_recording: Term = limited
    return term_of_recording


def recording_index_of(term: Term) -> int | None:
    """Return the index of the recording to which a cause is limited, or None."""
    return term.recording_index if isinstance(term, _OneRecordingMixin) else None


def is_active_in(term: Term, state: SignalState) -> bool:
    """Return whether a cause acts in the recording of a signal state."""
    return recording_index_of(term) in (None, state.context.recording_index)


def term_label(term: Term) -> str:
    """Return the id of a cause, with its occurrence after # and its recording after @, from 1.

    The first occurrence has no number, and a cause that acts in all recordings names none.
    """
    recording_index = recording_index_of(term)
    occurrence = "" if term.occurrence == 1 else f"#{term.occurrence}"
    recording = "" if recording_index is None else f"@{recording_index + 1}"
    return f"{term.cause}{occurrence}{recording}"


def occurrence_after(term: Term, labels: Set[str]) -> Term | None:
    """Return the first occurrence of a cause whose label is not in a set; None if there is none."""
    if term_label(term) not in labels:
        return term
    for occurrence in range(2, MAX_OCCURRENCES + 1) if term.is_event else ():
        later = copy(term)
        later.occurrence = occurrence
        if term_label(later) not in labels:
            return later
    return None


def value_labels(term: Term) -> tuple[str, ...]:
    """Return the name of each value of a term, preceded by the term's label, shape (k,)."""
    return tuple(f"{term_label(term)}.{name}" for name in value_names(term))


@cache
def _one_recording_class(term_class: type) -> type:
    return type(f"{term_class.__name__}InOneRecording", (_OneRecordingMixin, term_class), {})
