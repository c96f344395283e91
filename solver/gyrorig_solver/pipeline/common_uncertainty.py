"""The total uncertainty of a calibration over temperature, from that of its calibrations.

The noise of the inputs is independent, therefore the fit of a curve averages it. Their type B
uncertainty is from the same causes at each temperature: the same unit, mount and program. It is
taken as fully correlated, so the curve has the largest of it.

What to use when: `combined_uncertainty` for the calibration of a curve, whose verdict is that of
`judge_again`.

Source: JCGM 100:2008 (GUM), 5.2.2, note 1, and 6.2.
"""

import math
from collections.abc import Collection, Sequence

import msgspec

from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.calibration.calibration_document import (
    BudgetRow,
    ParameterUncertainty,
    Trust,
    UncertaintyRecord,
)
from gyrorig_solver.calibration.calibration_wording import value_std_pairs
from gyrorig_solver.calibration.total_uncertainty import MIN_SHARE, judge_total
from gyrorig_solver.model import group_of


def combined_uncertainty(
    document: CalibrationDocument,
    template: CalibrationDocument,
    fitted: Collection[str],
    inputs: Sequence[CalibrationDocument],
) -> UncertaintyRecord | None:
    """Return the record of a calibration whose parameters in `fitted` have new values.

    Args:
        document: with the new values and their type A uncertainty.
        template: the calibration that all other parameters are from.
        fitted: names of the fitted groups, for example `bias`.
        inputs: the calibrations to which the curve was fitted, without any other value.

    Returns:
        The record; None if an input does not state the uncertainty of each fitted value.
    """
    records = [calibration.uncertainty for calibration in inputs]
    base = template.uncertainty
    if base is None or not inputs:
        return None
    parameters = {
        name: entry for name, entry in base.parameters.items() if not _is_in(name, fitted)
    }
    budget = [row for row in base.budget if not _is_in(row.parameter, fitted)]
    for name, value, std in _fitted_values(document, fitted):
        entries = [
            (record.parameters[name], record)
            for record in records
            if record is not None and name in record.parameters
        ]
        if len(entries) < len(inputs):
            return None
        largest, record = max(entries, key=lambda entry: entry[0].type_b)
        total = math.hypot(std, largest.type_b)
        expanded = base.coverage_factor * total  # the errors of a curve are taken as normal
        parameters[name] = ParameterUncertainty(
            type_a=std,
            type_b=largest.type_b,
            total=total,
            interval=[value - expanded, value + expanded],
            limit=base.parameters[name].limit if name in base.parameters else largest.limit,
            unit=largest.unit,
        )
        budget += _shares_of(total, [row for row in record.budget if row.parameter == name])
    return msgspec.structs.replace(base, parameters=parameters, budget=budget)


def judge_again(trust: Trust, before: UncertaintyRecord | None, record: UncertaintyRecord) -> Trust:
    """Return a verdict with the reasons of another total uncertainty.

    Args:
        trust: of the template.
        before: the total uncertainty of the template, whose reasons are removed.
        record: the total uncertainty whose reasons are added.
    """
    if before is not None:
        old = judge_total(Trust("good", []), before).reasons
        reasons = [reason for reason in trust.reasons if reason not in old]
        is_good = trust.verdict == "limited" and not reasons
        trust = Trust("good" if is_good else trust.verdict, reasons)
    return judge_total(trust, record)


def _is_in(name: str, groups: Collection[str]) -> bool:
    group = group_of(name)
    return group is not None and group.name in groups


def _fitted_values(
    document: CalibrationDocument, fitted: Collection[str]
) -> list[tuple[str, float, float]]:
    """Return name, value and standard uncertainty of each fitted parameter."""
    return [
        (f"{group}.{axis}", value, std)
        for group in fitted
        for axis, (value, std) in zip(
            "xyz", value_std_pairs(document.parameters[group]), strict=True
        )
        if value is not None and std is not None
    ]


def _shares_of(total: float, rows: Sequence[BudgetRow]) -> list[BudgetRow]:
    """Return the contributions with their shares of another total variance."""
    shared = [
        msgspec.structs.replace(row, share=min(1.0, (row.contribution / total) ** 2))
        for row in rows
        if total > 0.0
    ]
    return [row for row in shared if row.share >= MIN_SHARE]
