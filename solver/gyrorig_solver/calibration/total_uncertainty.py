"""The total uncertainty of a calibration document: noise and causes, budget and verdict.

`std` and `covariance` of the document stay type A. The section `uncertainty` beside them has the
contribution of the causes that were not identified, the total, and where the total comes from.

Source: JCGM 100:2008 (GUM), 4.3, 5.1 and 6.2; the budget lists the largest contributions.
"""

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from gyrorig_solver.calibration.calibration_document import (
    BudgetRow,
    CalibrationDocument,
    Parameter,
    ParameterUncertainty,
    Trust,
    UncertaintyRecord,
)
from gyrorig_solver.calibration.calibration_wording import value_std_pairs
from gyrorig_solver.calibration.uncertainty_wording import contribution_name, main_contribution
from gyrorig_solver.discover import CALIBRATION_PARAMETERS
from gyrorig_solver.model import PARAMETER_GROUPS, format_short, group_of, parameter_label
from gyrorig_solver.numerics import normal_upper_tail
from gyrorig_solver.uncertainty import OtherEntry, UncertaintyBudget
from gyrorig_solver.uncertainty.uncertainty_budget import BudgetEntry

COVERAGE_FACTOR = 2.0  # of an interval if all errors are normal
MIN_SHARE = 0.01  # of the total variance; smaller contributions are not listed
MAX_ROWS = 4  # listed contributions to one parameter
NOISE_REMEDY = "record for longer, or solve several recordings together"


def with_total_uncertainty(
    calibration: CalibrationDocument, budget: UncertaintyBudget
) -> CalibrationDocument:
    """Return a calibration with its total uncertainty, and the effect of it on the verdict."""
    record = build_uncertainty(calibration, budget)
    trust = judge_total(calibration.trust, record)
    return msgspec.structs.replace(calibration, uncertainty=record, trust=trust)


def build_uncertainty(
    calibration: CalibrationDocument, budget: UncertaintyBudget
) -> UncertaintyRecord:
    """Return the record of every base parameter that has a value."""
    parameters: dict[str, ParameterUncertainty] = {}
    rows: list[BudgetRow] = []
    causes_std = dict(zip(CALIBRATION_PARAMETERS, budget.std, strict=True))
    base_values = _base_values(calibration.parameters)
    noise_std = {name: std for name, _, std, _ in base_values}
    probability = 1.0 - 2.0 * normal_upper_tail(COVERAGE_FACTOR)
    expanded = budget.expanded_uncertainty(
        np.array([noise_std.get(name, np.nan) for name in CALIBRATION_PARAMETERS]), probability
    )
    for name, value, std, unit in base_values:
        index = CALIBRATION_PARAMETERS.index(name)
        type_b = float(causes_std[name])
        total = math.hypot(std, type_b)
        parameters[name] = ParameterUncertainty(
            type_a=std,
            type_b=type_b,
            total=total,
            interval=[value - float(expanded[index]), value + float(expanded[index])],
            limit=budget.settings.limits[name.partition(".")[0]],
            unit=unit,
        )
        rows += _budget_rows(name, index, total, budget.entries)
    return UncertaintyRecord(
        coverage_factor=COVERAGE_FACTOR,
        coverage_probability=probability,
        parameters=parameters,
        budget=rows,
        settings_sha256=budget.settings.sha256,
    )


def judge_total(trust: Trust, record: UncertaintyRecord) -> Trust:
    """Return the verdict with a reason for each kind of parameter above its limit."""
    reasons = []
    for group in PARAMETER_GROUPS:
        above = {
            name: entry
            for name, entry in record.parameters.items()
            if group_of(name) is group and entry.total > entry.limit
        }
        if above:
            worst = max(above, key=lambda name: above[name].total)
            reasons.append(_limit_reason(worst, record))
    if not reasons:
        return trust
    verdict = "limited" if trust.verdict == "good" else trust.verdict
    return Trust(verdict=verdict, reasons=[*trust.reasons, *reasons])


def _limit_reason(name: str, record: UncertaintyRecord) -> str:
    entry, group = record.parameters[name], group_of(name)
    factor, unit = (1.0, "") if group is None or group.unit == "1" else (group.factor, group.unit)
    row = main_contribution(name, record)
    origin = "noise" if row is None else contribution_name(row)
    remedy = NOISE_REMEDY if row is None else row.remedy
    numbers = f"{format_short(entry.total * factor)} {unit}".strip()
    limit = f"{format_short(entry.limit * factor)} {unit}".strip()
    return (
        f"the total standard uncertainty of {name} is {numbers}, above the limit of {limit}. The "
        f"largest contribution is {origin}. To reduce it: {remedy}"
    )


def _base_values(
    parameters: dict[str, Parameter],
) -> list[tuple[str, float, float, str]]:
    """Return name, value, standard uncertainty and unit of each base parameter with a value."""
    rows = []
    for group in PARAMETER_GROUPS:
        parameter = parameters[group.name]
        for label, (value, std) in zip(group.labels, value_std_pairs(parameter), strict=True):
            if value is not None and std is not None:
                rows.append((parameter_label(group.name, label), value, std, parameter.unit))
    return rows


def _budget_rows(
    name: str, index: int, total: float, entries: Sequence[BudgetEntry | OtherEntry]
) -> list[BudgetRow]:
    order = np.argsort([-entry.std[index] for entry in entries], kind="stable")[:MAX_ROWS]
    rows = []
    for k in order:
        contribution = float(entries[k].std[index])
        share = min(1.0, (contribution / total) ** 2) if total > 0.0 else 0.0
        if share < MIN_SHARE:
            break
        entry = entries[k]
        rows.append(BudgetRow(name, entry.cause, entry.place, contribution, share, entry.remedy))
    return rows
