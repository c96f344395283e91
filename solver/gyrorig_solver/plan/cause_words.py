"""What a program shows of causes, for a person's eye and for a program's.

What to use when: `causes_table` and `causes_remarks` to print; `causes_plain` for JSON.
"""

import math
from collections.abc import Sequence
from itertools import groupby
from typing import Any

from gyrorig_solver.plan.causes import Foreseen, Outlook, Pair

_DEG = math.degrees(1.0)
# SI unit of a cause's size, what to multiply with, and what people at a rig say.
UNITS = {
    "rad": (_DEG * 1e3, "mdeg"),
    "rad/s": (_DEG * 1e3, "mdeg/s"),
    "rad/s^2": (_DEG * 1e3, "mdeg/s^2"),
    "rad/s/K": (_DEG * 1e3, "mdeg/s/K"),
    "rad/s/(m/s^2)": (_DEG * 1e3 * 9.80665, "mdeg/s/g"),
    "s/rad": (1e6 / _DEG, "ppm s/deg"),
    "s^2/rad^2": (1e6 / _DEG**2, "ppm s^2/deg^2"),
    "s": (1e3, "ms"),
    "s^2": (1e6, "ppm s^2"),
    "1": (1e6, "ppm"),
    "1/K": (1e6, "ppm/K"),
}
PERCENT_FROM = 1e4  # ppm
HEADER: tuple[str, ...] = ("cause", "seen from", "usual", "unit", "absorbed", "moves by", "what")


def causes_table(outlook: Outlook) -> str:
    """Return the causes that can be looked at, the most harmful first."""
    rows = [HEADER, *(_row(group) for _, group in _by_cause(outlook))]
    width = [max(len(row[k]) for row in rows) for k in range(len(HEADER))]
    return "\n".join(
        "  "
        + "  ".join(
            cell.rjust(width[k]) if k in (1, 2, 4, 5) else cell.ljust(width[k])
            for k, cell in enumerate(row)
        ).rstrip()
        for row in rows
    )


def causes_remarks(outlook: Outlook) -> list[str]:
    """Return what is confusable, what cannot be seen, and why, a sentence each."""
    said = []
    for pair in outlook.pairs:
        said.append(f"{_pair(pair)}; {_separates(outlook, pair)}")
    for cause, group in _by_cause(outlook):
        lost = [f for f in group if not f.visible]
        if lost:
            where = ", ".join(f.place for f in lost if f.place)
            named = f"{cause} ({where})" if where and len(lost) < len(group) else cause
            said.append(
                f"{named} cannot be seen with this program at any size that is possible; "
                f"it needs {lost[0].term.excitation}"
            )
    for term in outlook.gauges:
        said.append(
            f"{term.cause} cannot be seen in any motion, the calibration takes it whole "
            f"({term.harm}); it needs {term.excitation}"
        )
    for term, why in outlook.missing:
        said.append(f"{term.cause} cannot be looked at: {why}")
    if outlook.elsewhere:
        names = ", ".join(term.cause for term in outlook.elsewhere)
        said.append(f"{names}: looked for in the noise or the raw stream, with any program")
    return said


def causes_plain(outlook: Outlook) -> dict[str, Any]:
    """Return all of it as plain values, in SI units."""
    return {
        "foreseen": [
            {
                "cause": f.term.cause,
                "part": f.term.part,
                "place": f.place,
                "unit": f.unit,
                "detectable": f.smallest if math.isfinite(f.smallest) else None,
                "detectable_worst": f.largest if math.isfinite(f.largest) else None,
                "typical": f.typical,
                "visible": f.visible,
                "absorbed": f.absorbed,
                "harm_sigma": f.harm,
                "harm_parameter": f.moves,
            }
            for f in outlook.foreseen
        ],
        "confusable": [
            {
                "causes": list(pair.causes),
                "places": list(pair.places),
                "share": pair.share,
                "separated_by": _separates(outlook, pair),
            }
            for pair in outlook.pairs
        ],
        "unseen_by_any_motion": [term.cause for term in outlook.gauges],
        "elsewhere": [term.cause for term in outlook.elsewhere],
        "missing": {term.cause: why for term, why in outlook.missing},
    }


def _by_cause(outlook: Outlook) -> list[tuple[str, list[Foreseen]]]:
    """Return the causes with their places, in order of the worst harm."""
    ordered = sorted(outlook.foreseen, key=lambda f: f.term.cause)
    found = [(k, list(group)) for k, group in groupby(ordered, key=lambda f: f.term.cause)]
    return sorted(found, key=lambda one: -max(f.harm for f in one[1]))


def _row(group: Sequence[Foreseen]) -> tuple[str, ...]:
    seen = [f for f in group if f.visible]
    worst = max(group, key=lambda f: f.harm)
    factor, unit = UNITS.get(worst.unit, (1.0, worst.unit))
    if unit == "ppm" and worst.typical * factor >= PERCENT_FROM:
        factor, unit = 100.0, "%"
    sizes = sorted({_number(v * factor) for f in seen for v in (f.smallest, f.largest)}, key=float)
    return (
        worst.term.cause,
        " to ".join(dict.fromkeys((sizes[0], sizes[-1]))) if sizes else "never",
        _number(worst.typical * factor),
        unit,
        f"{worst.absorbed * 100.0:.1f} %",
        f"{worst.harm:.1f}",
        worst.moves if worst.harm >= 0.05 else "",
    )


def _pair(pair: Pair) -> str:
    names = [
        f"{cause} ({place})" if place else cause
        for cause, place in zip(pair.causes, pair.places, strict=True)
    ]
    return f"{names[0]} looks like {names[1]}, {pair.share * 100.0:.0f} %"


def _separates(outlook: Outlook, pair: Pair) -> str:
    terms = {f.term.cause: f.term for f in outlook.foreseen}
    said = dict.fromkeys(terms[cause].excitation for cause in pair.causes)
    return f"to tell them apart: {'; or '.join(said)}"


def _number(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
