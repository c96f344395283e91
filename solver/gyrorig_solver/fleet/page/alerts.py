"""Alerts: what the fleet's statistics found, as sentences with a reason and an action.

What to use when: `fleet_alerts` for the page and for `gyrorig fleet`. The order is by reach: a
common offset affects every unit, a rig all its boards, a lot its parts, a drift one board.
"""

from dataclasses import dataclass
from itertools import islice

import numpy as np

from gyrorig_solver.fleet.column_units import column_label, column_unit, format_shift
from gyrorig_solver.fleet.drift import PARAMETER_COLUMNS, FleetOverview, OffsetComparison
from gyrorig_solver.fleet.drift.common_offsets import CLOCK_PARAMETER, CommonOffset
from gyrorig_solver.model import plural

MAX_BOARDS_NAMED = 20  # the page lists all of them
CRYSTAL_TOLERANCE_PPM = 50.0  # usual tolerance of crystals; a clock within it raises no alert


@dataclass(frozen=True, slots=True)
class Alert:
    """One finding that needs attention."""

    kind: str  # constant | rig | lot | site | drift | odd | work | trust | prior
    finding: str
    reason: str
    action: str
    search_filter: str = ""  # text for the page's search that selects the boards


def fleet_alerts(overview: FleetOverview) -> list[Alert]:
    """Return the alerts of a fleet, those with the widest reach first."""
    return [
        *_offset_alerts(overview),
        *_group_shift_alerts(overview),
        *_group_difference_alerts(overview),
        *_unsuccessful_work_alerts(overview),
        *_drift_alerts(overview),
        *_outlier_alerts(overview),
        *_refused_alerts(overview),
        *_prior_dominated_alerts(overview),
    ]


def _offset_alerts(overview: FleetOverview) -> list[Alert]:
    """Return one alert per common offset; the biases of a sensor share one."""
    parameters: list[Alert] = []
    clocks: list[Alert] = []
    biases: dict[str, list[OffsetComparison]] = {}
    for comparison in overview.offset_comparisons:
        offset = comparison.result
        if not offset.is_common:
            continue
        if offset.parameter == CLOCK_PARAMETER:
            if abs(offset.offset) > CRYSTAL_TOLERANCE_PPM:
                clocks.append(_clock_alert(comparison))
        elif offset.parameter.startswith("bias"):
            biases.setdefault(comparison.name, []).append(comparison)
        else:
            parameters.append(_parameter_offset_alert(comparison))
    return [*parameters, *map(_bias_offset_alert, biases.values()), *clocks]


def _parameter_offset_alert(comparison: OffsetComparison) -> Alert:
    offset = comparison.result
    return Alert(
        "constant",
        f"{column_label(offset.parameter)} is off by "
        f"{format_shift(offset.parameter, offset.offset)} on every {comparison.name}",
        _common_share_words(offset),
        _offset_remedy(offset.parameter),
        f"sensor:{comparison.name}",
    )


def _bias_offset_alert(comparisons: list[OffsetComparison]) -> Alert:
    """Return the alert on a sensor's common bias, in counts where all boards count alike."""
    sensor, count_rad_s = comparisons[0].name, comparisons[0].count_size_rad_s
    offsets = [comparison.result for comparison in comparisons]
    names = ", ".join(column_label(offset.parameter) for offset in offsets)
    factor, unit = column_unit(offsets[0].parameter)
    sizes = ", ".join(f"{factor * offset.offset:+.3g}" for offset in offsets)
    reason = _common_share_words(offsets[0])
    if count_rad_s is not None:
        counts = ", ".join(f"{offset.offset / count_rad_s:+.2f}" for offset in offsets)
        reason = f"This is {counts} of one count. {reason}"
    return Alert(
        "constant",
        f"{names} {'are' if len(offsets) > 1 else 'is'} off by {sizes} {unit} on every {sensor}",
        reason,
        "Check shifts and casts in the firmware: truncating instead of rounding makes every axis "
        "half a count too low. If one axis alone is off, look for an offset that is subtracted "
        "somewhere, or for the Earth's rotation (at most 0.0042 deg/s).",
        f"sensor:{sensor}",
    )


def _clock_alert(comparison: OffsetComparison) -> Alert:
    offset = comparison.result
    if comparison.kind == "rig":
        subject = f"the clocks of all boards of {_group_label('rig', comparison.name)} are"
        consequence = "Every scale measured on this rig is off by the same ratio."
        action = (
            "Compare the host's clock with another clock: each board has a separate clock, so a "
            "common error comes from the host. With one rig and one kind of board the tick rate "
            "in the sensor's profile is possible too."
        )
    else:
        subject = f"the clock of every {comparison.name} is"
        consequence = "Scales are not affected: rates are timed by the host's clock."
        action = (
            "Check the tick rate in the profile and in the firmware against the part. The host's "
            "clock is not the cause, because boards on several rigs agree."
        )
    return Alert(
        "constant",
        f"{subject} off by {offset.offset:+.3g} ppm",
        f"{_common_share_words(offset)} {consequence}",
        action,
        group_filter(comparison.kind, comparison.name),
    )


def _common_share_words(offset: CommonOffset) -> str:
    return (
        f"The fleet's mean is {offset.z:+.0f} standard deviations from nominal, and "
        f"{offset.share:.0%} of the mean square error is the same on all units. Random "
        "differences between the sensors do not explain this."
    )


def _offset_remedy(parameter: str) -> str:
    if parameter.startswith("scale"):
        return (
            "Compare the scale factor in the sensor's profile with its data sheet. Check for "
            "truncated counts, and compare the host's clock with another clock."
        )
    if parameter.startswith("misalignment"):
        return (
            "Measure the fixture, because it turns every board by the same angle. You can "
            "also accept this angle as the new zero."
        )
    return "Check the order of the axes in the profile, and the fixture."


def _group_shift_alerts(overview: FleetOverview) -> list[Alert]:
    alerts: list[Alert] = []
    for shift in overview.group_shifts:
        is_fleet = shift.kind == "fleet"
        label = "the whole fleet" if is_fleet else _group_label(shift.kind, shift.group)
        action = (
            (
                "Check what all boards have in common: the solver's version, the sensor profile "
                "and the host's clock."
            )
            if is_fleet
            else f"Check {label}: levels, screws, gears and clock. Run gyrorig explain on its last "
            "recordings to find the cause."
        )
        alerts.append(
            Alert(
                shift.kind,
                f"{label}: {column_label(shift.parameter)} has shifted by "
                f"{format_shift(shift.parameter, shift.shift)}",
                f"Its {shift.board_count} boards have shifted together, by {shift.z:+.1f} standard "
                "deviations. A shift of all boards at once does not come from the boards.",
                action,
                "" if is_fleet else group_filter(shift.kind, shift.group),
            )
        )
    return alerts


def _group_difference_alerts(overview: FleetOverview) -> list[Alert]:
    """Return the groups that differ, without those that have an alert for a shift already."""
    shifted = {(shift.kind, shift.group, shift.parameter) for shift in overview.group_shifts}
    return [
        Alert(
            kind,
            f"{_group_label(kind, difference.extreme_group)} differs in "
            f"{column_label(difference.parameter)} of {sensor} "
            f"by {format_shift(difference.parameter, difference.extreme_offset)}",
            f"It is {difference.extreme_z:+.1f} standard deviations from the mean of "
            f"{difference.group_count} {kind}s, more than boards differ from each other.",
            "If the group is a lot, ask the manufacturer. If the group is a rig or a site, "
            "measure one board on two rigs or sites.",
            group_filter(kind, difference.extreme_group),
        )
        for sensor, kind, difference in overview.group_differences
        if (kind, difference.extreme_group, difference.parameter) not in shifted
    ]


def _unsuccessful_work_alerts(overview: FleetOverview) -> list[Alert]:
    actions = {
        "quarantined": "Run gyrorig solve on one of these recordings, and report its output.",
        "failed": "Run gyrorig store ls STORE --wrong for the reasons; add --json for the "
        "tracebacks.",
        "rejected": "Run gyrorig store ls STORE --wrong for the reasons, and gyrorig check on one "
        "of the recordings.",
    }
    reasons = {
        "quarantined": (
            "Each of these recordings ended its worker process twice, so it gave no calibration."
        ),
        "failed": "The program failed on these recordings, so they gave no calibration.",
        "rejected": "These recordings cannot be solved, so they gave no calibration.",
    }
    return [
        Alert(
            "work",
            f"{plural(count, 'session')} {status}",
            reasons[status],
            actions[status],
        )
        for status, count in overview.unsuccessful
    ]


def _drift_alerts(overview: FleetOverview) -> list[Alert]:
    boards = np.flatnonzero(overview.drifting.any(axis=1))
    order = sorted(boards, key=lambda index: -float(np.abs(overview.drift_z[index]).max()))
    alerts: list[Alert] = []
    for index in islice(order, MAX_BOARDS_NAMED):
        scores = np.where(overview.drifting[index], np.abs(overview.drift_z[index]), -1.0)
        worst = int(np.argmax(scores))
        board = overview.boards.board[index]
        alerts.append(
            Alert(
                "drift",
                f"board {board} drifts in {column_label(PARAMETER_COLUMNS[worst])}",
                f"The value is {overview.drift_z[index, worst]:+.1f} standard deviations from its "
                "first nights, after the shifts of its rig and site are subtracted.",
                "Measure the board again. If the drift continues, the earlier calibrations "
                "no longer describe this board.",
                f"board:{board}",
            )
        )
    return _with_remainder(alerts, len(order), "drift", "boards drift", "is:drifting")


def _outlier_alerts(overview: FleetOverview) -> list[Alert]:
    p_values = overview.outlier_p_value
    order = sorted(np.flatnonzero(overview.is_outlier), key=lambda index: float(p_values[index]))
    alerts = [
        Alert(
            "odd",
            f"board {overview.boards.board[index]} is an outlier among boards of its kind",
            f"By chance, one of {_one_in(float(p_values[index]))} boards differs as much.",
            "Check whether the part is damaged, whether another part has this name, and whether "
            "its settings differ.",
            f"board:{overview.boards.board[index]}",
        )
        for index in islice(order, MAX_BOARDS_NAMED)
    ]
    return _with_remainder(alerts, len(order), "odd", "boards are outliers", "is:outlier")


def _refused_alerts(overview: FleetOverview) -> list[Alert]:
    refused = overview.boards.trust.count("refused")
    if not refused:
        return []
    return [
        Alert(
            "trust",
            f"{plural(refused, 'board has', 'boards have')} a refused latest calibration",
            "The reasons and remedies are in each calibration.",
            "Open the reports of these boards, and follow their advice.",
            "verdict:refused",
        )
    ]


def _prior_dominated_alerts(overview: FleetOverview) -> list[Alert]:
    """Return the parameters that the calibrations of a sensor determine worse than the fleet."""
    return [
        Alert(
            "prior",
            f"the calibrations of {int(fitted.prior_dominated.sum())} of {fitted.boards} {sensor} "
            f"determine {column_label(name)} worse than the fleet's mean does",
            "The uncertainty of a calibration is larger than the spread between boards, so the "
            "shrinkage estimates mostly repeat the fleet's mean.",
            "Record for longer, or use a motion program that determines the parameter "
            "better (see gyrorig plan).",
            f"is:prior sensor:{sensor}",
        )
        for (sensor, name), fitted in overview.populations.items()
        if fitted.prior_dominated.mean() > 0.5
    ]


def _with_remainder(
    alerts: list[Alert], count: int, kind: str, words: str, search_filter: str
) -> list[Alert]:
    if count > len(alerts):
        more = f"{count} {words}, {count - len(alerts)} of them not listed"
        alerts.append(Alert(kind, more, "", "", search_filter))
    return alerts


def group_filter(kind: str, name: str) -> str:
    """Return the text for the page's search that selects the boards of a group."""
    return f'{kind}:"{name}"' if " " in name else f"{kind}:{name}"


def _one_in(p_value: float) -> str:
    """Return the reciprocal of a chance; smaller tails than 1e-12 mean nothing."""
    return f"{1.0 / p_value:.2g}" if p_value > 1e-12 else "more than 1e12"


def _group_label(kind: str, group: str) -> str:
    """Return a group's name after its kind, without the kind where the name begins with it."""
    return group if group.startswith(kind) else f"{kind} {group}"
