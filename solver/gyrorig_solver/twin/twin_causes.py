"""The causes of a twin, from the findings of each board.

A cause of the unit is in the findings of every board; the twin has it once.

What to use when: `collect_causes`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gyrorig_protocol.twin import Scalar, TwinCause
from gyrorig_solver.discover import NamedCause
from gyrorig_solver.estimate import is_unit_cause
from gyrorig_solver.findings import CauseEntry
from gyrorig_solver.model import Term, value_labels, value_names, value_parameters
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.pipeline import CriticisedFit
from gyrorig_solver.pipeline.explain_board import build_document
from gyrorig_solver.twin.quantities import scalar


@dataclass(slots=True, eq=False)
class CollectedCauses:
    """The causes of a twin, and the places of their values in each board's fit."""

    causes: list[TwinCause] = field(default_factory=list)
    # By board: label of a value in its fit, and number and parameter of the twin's cause.
    places: dict[str, dict[str, tuple[int, str]]] = field(default_factory=dict)
    alternatives: list[tuple[str, ...]] = field(default_factory=list)  # of each cause
    not_emulated: list[str] = field(default_factory=list)  # causes that are not a property of a rig


def collect_causes(fits: Mapping[str, CriticisedFit], recordings: Sequence[str]) -> CollectedCauses:
    """Return the causes of all boards, each with the values that the findings state.

    Args:
        fits: of each board, with its findings.
        recordings: names of all of them.
    """
    collected = CollectedCauses()
    numbers: dict[tuple[str, str | None, str | None], int] = {}
    for board, criticised in fits.items():
        collected.places[board] = {}
        explanation = criticised.explanation
        if explanation is None:
            continue
        named = {
            (c.cause, c.term.occurrence, ", ".join(c.where) or "all", c.recording): c
            for c in explanation.findings.causes
        }
        for entry in build_document(explanation).causes:
            cause = named.get((entry.cause, entry.occurrence, entry.where, entry.recording))
            if entry.cause not in catalogue():
                collected.not_emulated.append(entry.cause)
                continue
            owner = None if cause is not None and _belongs_to_unit(cause) else board
            recording = _recording_of(entry, recordings)
            key = (f"{entry.cause}#{entry.occurrence}", owner, recording)
            if owner is not None and key in numbers:  # the same cause at several places
                key = (f"{key[0]}@{entry.where}", owner, recording)
            if key not in numbers:
                is_common = owner is None and len(fits) > 1
                sizes = _stated_sizes(entry) if cause is None else _fitted_sizes(cause)
                if cause is not None and is_common:
                    sizes |= _common_sizes(criticised, cause)
                twin_cause = _twin_cause(entry, owner, recording, sizes)
                if twin_cause is None:
                    continue
                numbers[key] = len(collected.causes)
                collected.causes.append(twin_cause)
                collected.alternatives.append(tuple(entry.one_of))
            if cause is not None:
                collected.places[board] |= _places(cause.term, numbers[key], collected)
        _add_known_causes(criticised, collected, numbers)
    return collected


def _recording_of(entry: CauseEntry, recordings: Sequence[str]) -> str | None:
    """Return the recording in which a cause happened, None if it acts in all.

    Findings of one recording do not name it, but a single event is not in any other recording.
    """
    if len(recordings) == 1 and catalogue()[entry.cause].is_event:
        return recordings[0]
    return entry.recording


def _twin_cause(
    entry: CauseEntry, owner: str | None, recording: str | None, sizes: dict[str, Scalar]
) -> TwinCause | None:
    if not sizes:
        return None
    return TwinCause(entry.cause, entry.where, sizes, owner, recording)


def _stated_sizes(entry: CauseEntry) -> dict[str, Scalar]:
    """Return the values of a cause that the checks of the raw samples detected."""
    return {
        name: Scalar(size.value, size.std, size.unit)
        for name, size in entry.parameters.items()
        if size.value is not None
    }


def _fitted_sizes(cause: NamedCause) -> dict[str, Scalar]:
    """Return all values of a cause in the fit.

    The findings state the values that differ from zero. The others belong to the same fit: without
    them, bias and sensor matrix would be wrong.
    """
    sizes = {value.name: scalar(value.value, value.std, value.unit) for value in cause.values}
    return {name: size for name, size in sizes.items() if size is not None}


def _common_sizes(criticised: CriticisedFit, cause: NamedCause) -> dict[str, Scalar]:
    """Return the sizes of a unit's cause in the joint fit of all boards.

    The findings of each board have the sizes of the search, before the joint fit.
    """
    solution, fit = criticised.solution, criticised.fit
    if solution is None:
        return {}
    labels = value_labels(cause.term)
    fitted = next((f for f in solution.fitted_terms if value_labels(f.term) == labels), None)
    if fitted is None:
        return {}
    units = {value.name: value.unit for value in cause.values}
    return {
        name: Scalar(float(value), fit.std[label], units[name])
        for label, name, value in zip(labels, value_names(cause.term), fitted.values, strict=True)
        if np.isfinite(fit.std.get(label, np.nan))
    }


def _belongs_to_unit(cause: NamedCause) -> bool:
    """Return whether a cause is one of the unit or of the environment.

    A cause of the unit can be attributed to boards with different sizes; a rig has it once.
    """
    if is_unit_cause(cause.term) or cause.part == "environment":
        return True
    return cause.attribution is not None and cause.attribution.owner == "unit"


def _places(term: Term, number: int, collected: CollectedCauses) -> dict[str, tuple[int, str]]:
    parameters = collected.causes[number].parameters
    return {
        label: (number, name)
        for label, name in zip(value_labels(term), value_names(term), strict=True)
        if name in parameters
    }


def _add_known_causes(
    criticised: CriticisedFit,
    collected: CollectedCauses,
    numbers: dict[tuple[str, str | None, str | None], int],
) -> None:
    """Add the causes that the fit has removed as known, such as the rotation of the Earth."""
    solution = criticised.solution
    for fitted in () if solution is None else solution.fitted_terms:
        key = (f"{fitted.term.cause}#1", None, None)
        if fitted.term.kind != "known" or key in numbers:
            continue
        sizes = {
            name: Scalar(float(value), None, parameter.unit, "profile")
            for name, value, parameter in zip(
                value_names(fitted.term),
                fitted.values,
                value_parameters(fitted.term),
                strict=True,
            )
        }
        numbers[key] = len(collected.causes)
        collected.causes.append(TwinCause(fitted.term.cause, "all", sizes))
        collected.alternatives.append(())
