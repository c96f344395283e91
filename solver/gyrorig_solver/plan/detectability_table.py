"""Tables and notes about the causes that a program can detect.

What to use when: `causes_summary` for a short text, `causes_table` and `causes_notes` for the
complete text; `causes_to_builtins` for JSON.
"""

import math
from collections.abc import Sequence
from itertools import groupby
from typing import Any

from gyrorig_solver.data.text_table import format_table
from gyrorig_solver.discover import FALSE_ALARM_RATE
from gyrorig_solver.discover.score_tests import DETECTION_POWER
from gyrorig_solver.model import cause_display_unit, plural
from gyrorig_solver.plan.detectability import (
    CauseDetectability,
    ConfusablePair,
    DetectabilityReport,
)

# What a detectable size means.
DETECTION_TEXT = f"power {100.0 * DETECTION_POWER:g} %, false alarms {100.0 * FALSE_ALARM_RATE:g} %"
HEADER = ("cause", "detectable", "typical", "unit", "absorbed", "bias, sigma", "of")


def causes_table(report: DetectabilityReport) -> str:
    """Return the testable causes, the largest parameter bias first."""
    rows = [HEADER, *(_row(group) for _, group in _group_by_cause(report))]
    return "\n".join(f"  {line}" for line in format_table(rows, right=(1, 2, 4, 5)))


def causes_summary(report: DetectabilityReport, program: str, causes: int) -> list[str]:
    """Return counts, and the causes with the largest bias below their detectable size."""
    groups = _group_by_cause(report)
    detectable = sum(any(place.is_detectable for place in group) for _, group in groups)
    lines = [
        f"{program} can detect {detectable} of {plural(len(groups), 'cause')} ({DETECTION_TEXT}); "
        f"{plural(len(report.confusable_pairs), 'pair')} of causes can be confused. All: --details"
    ]
    for cause, group in groups[:causes]:
        _, size, typical, unit, _, bias, parameter = _row(group)
        if size == "never":
            limit = f"{cause} at any size; its typical size of {typical} {unit}"
        else:
            limit = f"{cause} below {size.rpartition(' ')[2]} {unit}; a smaller size"
        lines.append(
            f"  not detectable: {limit} would bias {parameter} by up to {bias} standard "
            "uncertainties"
        )
    return lines


def causes_notes(report: DetectabilityReport) -> list[str]:
    """Return one note for each confusable pair and each cause that cannot be tested."""
    notes = [
        f"The program cannot distinguish {_pair_text(pair)}. "
        f"To separate them, record: {_separation_text(report, pair)}."
        for pair in report.confusable_pairs
    ]
    for cause, group in _group_by_cause(report):
        undetectable = [place for place in group if not place.is_detectable]
        if undetectable:
            places = ", ".join(place.place for place in undetectable if place.place)
            named = f"{cause} ({places})" if places and len(undetectable) < len(group) else cause
            notes.append(
                f"The program cannot detect {named} at any possible size. "
                f"To detect this cause, record: {undetectable[0].term.excitation}."
            )
    for term in report.fully_absorbed:
        notes.append(
            f"The calibration absorbs {term.cause} completely, so motion alone cannot show it. "
            f"Effect on the calibration: {term.effect_if_ignored}. "
            f"To show it, use: {term.excitation}."
        )
    for term, reason in report.not_applicable:
        notes.append(f"The program cannot test {term.cause}: {reason}.")
    if report.other_methods:
        names = ", ".join(term.cause for term in report.other_methods)
        notes.append(f"With any program, the noise or the raw samples show these causes: {names}.")
    return notes


def causes_to_builtins(report: DetectabilityReport) -> dict[str, Any]:
    """Return the report as plain values, in SI units."""
    return {
        "foreseen": [
            {
                "cause": cause.term.cause,
                "part": cause.term.part,
                "place": cause.place,
                "unit": cause.unit,
                "detectable": cause.best_direction_size
                if math.isfinite(cause.best_direction_size)
                else None,
                "detectable_worst": cause.worst_direction_size
                if math.isfinite(cause.worst_direction_size)
                else None,
                "typical": cause.typical,
                "visible": cause.is_detectable,
                "absorbed": cause.absorbed,
                "harm_sigma": cause.parameter_bias_sigma,
                "harm_parameter": cause.biased_parameter,
            }
            for cause in report.causes
        ],
        "confusable": [
            {
                "causes": list(pair.causes),
                "places": list(pair.places),
                "share": pair.share,
                "separated_by": f"to separate them: {_separation_text(report, pair)}",
            }
            for pair in report.confusable_pairs
        ],
        "unseen_by_any_motion": [term.cause for term in report.fully_absorbed],
        "elsewhere": [term.cause for term in report.other_methods],
        "missing": {term.cause: reason for term, reason in report.not_applicable},
    }


def _group_by_cause(report: DetectabilityReport) -> list[tuple[str, list[CauseDetectability]]]:
    """Return the causes with their places, the largest parameter bias first."""
    ordered = sorted(report.causes, key=lambda cause: cause.term.cause)
    groups = [(k, list(group)) for k, group in groupby(ordered, key=lambda cause: cause.term.cause)]
    return sorted(groups, key=lambda entry: -max(cause.parameter_bias_sigma for cause in entry[1]))


def _row(group: Sequence[CauseDetectability]) -> tuple[str, ...]:
    detectable = [cause for cause in group if cause.is_detectable]
    worst = max(group, key=lambda cause: cause.parameter_bias_sigma)
    factor, unit = cause_display_unit(worst.term.cause, "", worst.unit)
    sizes = sorted(
        {
            _short_number(size * factor)
            for cause in detectable
            for size in (cause.best_direction_size, cause.worst_direction_size)
        },
        key=float,
    )
    return (
        worst.term.cause,
        " to ".join(dict.fromkeys((sizes[0], sizes[-1]))) if sizes else "never",
        _short_number(worst.typical * factor),
        unit,
        f"{worst.absorbed * 100.0:.1f} %",
        f"{worst.parameter_bias_sigma:.1f}",
        worst.biased_parameter if worst.parameter_bias_sigma >= 0.05 else "",
    )


def _pair_text(pair: ConfusablePair) -> str:
    names = [
        f"{cause} ({place})" if place else cause
        for cause, place in zip(pair.causes, pair.places, strict=True)
    ]
    return f"{names[0]} from {names[1]} (overlap {pair.share * 100.0:.0f} %)"


def _separation_text(report: DetectabilityReport, pair: ConfusablePair) -> str:
    terms = {cause.term.cause: cause.term for cause in report.causes}
    excitations = dict.fromkeys(terms[cause].excitation for cause in pair.causes)
    return "; or ".join(excitations)


def _short_number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
