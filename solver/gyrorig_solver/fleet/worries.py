"""What to look at first: a fleet's findings as sentences, the widest reaching first.

What to use when: `worries` for the page and for `gyrorig fleet`. A constant that is wrong on
every unit reaches further than a rig, a rig further than a lot's parts, a lot than a board.
"""

from dataclasses import dataclass
from itertools import islice

import numpy as np

from gyrorig_solver.fleet.constants import (
    CLOCK,
    CommonConstant,
    Constancy,
)
from gyrorig_solver.fleet.constants import parameter_words as _words
from gyrorig_solver.fleet.overview import PARAMETERS, Overview

BOARDS_NAMED = 20  # the page lists all of them
CRYSTAL_PPM = 50.0  # what crystals keep to, host's and board's; a clock within it is in order


@dataclass(frozen=True, slots=True)
class Worry:
    """One thing to look at."""

    kind: str  # constant | rig | lot | site | drift | odd | work | trust | prior
    what: str
    why: str
    do: str
    find: str = ""  # what to put into the page's search to see the boards


def worries(found: Overview) -> list[Worry]:
    """Return what to look at, the widest reaching first."""
    return [
        *_constants(found),
        *_moved(found),
        *_differing(found),
        *_work(found),
        *_drifting(found),
        *_odd(found),
        *_refused(found),
        *_loose(found),
    ]


def _constants(found: Overview) -> list[Worry]:
    common = [one for one in found.constants if one.told.is_common]
    clocks = [one for one in common if one.told.parameter == CLOCK]
    biases = [one for one in common if one.told.parameter.startswith("bias")]
    return [
        *(_number(one) for one in common if one not in clocks and one not in biases),
        *(
            _offset([one for one in biases if one.name == sensor])
            for sensor in dict.fromkeys(one.name for one in biases)
        ),
        *(_clock(one) for one in clocks if abs(one.told.offset) > CRYSTAL_PPM),
    ]


def _number(one: Constancy) -> Worry:
    told = one.told
    return Worry(
        "constant",
        f"{_words(told.parameter)} is off by {_sized(told.parameter, told.offset)} "
        f"on every {one.name}",
        _same(told),
        _constant_remedy(told.parameter),
        f"sensor:{one.name}",
    )


def _offset(axes: list[Constancy]) -> Worry:
    """Say by how much the biases of every unit are off, in counts where all count alike."""
    names = " and ".join(_words(one.told.parameter) for one in axes)
    sizes = ", ".join(f"{one.told.offset:+.3g}" for one in axes)
    count = axes[0].count_rad_s
    counts = "" if count is None else ", ".join(f"{one.told.offset / count:+.2f}" for one in axes)
    return Worry(
        "constant",
        f"{names} are off by {sizes} rad/s on every {axes[0].name}"
        if len(axes) > 1
        else f"{names} is off by {sizes} rad/s on every {axes[0].name}",
        (f"that is {counts} of a count; " if counts else "") + _same(axes[0].told),
        "counts that are cut off instead of rounded are half a count low on every axis: look at "
        "shifts and casts in the firmware; one axis alone is an offset that somebody takes off, or "
        "the Earth's turning (at most 7.3e-5 rad/s)",
        f"sensor:{axes[0].name}",
    )


def _clock(one: Constancy) -> Worry:
    told = one.told
    if one.kind == "rig":
        what = f"the clocks of all boards of {_named('rig', one.name)} are off by"
        counts = "; every scale measured there is off by as much"
        do = (
            "boards' own clocks differ: it is the host's, so compare it with another; with one rig "
            "and one kind of board it may be the profile's tick rate too"
        )
    else:
        what, counts, do = (
            f"the clock of every {one.name} is off by",
            "; scales are not: rates count by the host's clock",
            "on several rigs, so no host's: the tick rate in the profile or the firmware is not "
            "what the part counts by",
        )
    return Worry(
        "constant",
        f"{what} {told.offset:+.3g} ppm",
        _same(told) + counts,
        do,
        find_group(one.kind, one.name),
    )


def _same(told: CommonConstant) -> str:
    return (
        f"{told.z:+.0f} standard deviations of the fleet's mean, and {told.share:.0%} of it "
        "is the same on all units: parts do not do that"
    )


def _constant_remedy(parameter: str) -> str:
    if parameter.startswith("scale"):
        return (
            "compare the rate of one count in the sensor's profile with its data sheet, the "
            "counts' truncation, and the host's clock with another one"
        )
    if parameter.startswith("misalignment"):
        return "the fixture turns every board so: measure it, or take it as the new zero"
    return "look at the order of axes in the profile, and at the fixture"


def _moved(found: Overview) -> list[Worry]:
    told: list[Worry] = []
    for one in found.moved:
        whole = one.kind == "fleet"
        who = "the whole fleet" if whole else _named(one.kind, one.group)
        do = (
            "look for what all have in common: the solver's version, a profile, the host's clock"
            if whole
            else f"look at {who}: levels, screws, gears, clock; `gyrorig explain` of its last "
            "recordings names causes"
        )
        told.append(
            Worry(
                one.kind,
                f"{who} has moved {_words(one.parameter)} by {_sized(one.parameter, one.moved)}",
                f"its {one.boards} boards together, {one.z:+.1f} standard deviations: what moves "
                "on all boards at once is not the boards",
                do,
                "" if whole else find_group(one.kind, one.group),
            )
        )
    return told


def _differing(found: Overview) -> list[Worry]:
    """Say which groups differ, those left out that are told to have moved."""
    moved = {(one.kind, one.group, one.parameter) for one in found.moved}
    return [
        Worry(
            kind,
            f"{_named(kind, one.most)} differs in {_words(one.parameter)} of {sensor} "
            f"by {_sized(one.parameter, one.most_by)}",
            f"{one.most_z:+.1f} standard deviations from the {one.groups} {kind}s' mean, beyond "
            "what boards differ by",
            "of a lot ask its maker; of a rig or site have one board measured on two of them",
            find_group(kind, one.most),
        )
        for sensor, kind, one in found.differing
        if (kind, one.most, one.parameter) not in moved
    ]


def _work(found: Overview) -> list[Worry]:
    remedies = {
        "quarantined": "each killed its worker twice: run `gyrorig solve` on one of them alone, "
        "and report what it says",
        "failed": "`gyrorig store ls STORE --wrong` shows reasons; `--json` has their traces too",
        "rejected": "`gyrorig store ls STORE --wrong` says why; `gyrorig check` looks at one",
    }
    return [
        Worry("work", f"{count} recordings {status}", "they gave no calibration", remedies[status])
        for status, count in found.wrong
    ]


def _drifting(found: Overview) -> list[Worry]:
    boards = np.flatnonzero(found.drifting.any(axis=1))
    order = sorted(boards, key=lambda at: -float(np.abs(found.drift_z[at]).max()))
    told: list[Worry] = []
    for at in islice(order, BOARDS_NAMED):
        which = int(np.argmax(np.where(found.drifting[at], np.abs(found.drift_z[at]), -1.0)))
        board = found.boards.board[at]
        told.append(
            Worry(
                "drift",
                f"board {board} drifts in {_words(PARAMETERS[which])}",
                f"{found.drift_z[at, which]:+.1f} standard deviations from its first nights, its "
                "rig's and site's moves taken off",
                "measure it again; if it goes on, its earlier calibrations are of another board",
                f"board:{board}",
            )
        )
    return _with_more(told, len(order), "drift", "boards drift", "is:drifting")


def _odd(found: Overview) -> list[Worry]:
    order = sorted(np.flatnonzero(found.odd), key=lambda at: float(found.odd_p[at]))
    told = [
        Worry(
            "odd",
            f"board {found.boards.board[at]} is unlike all others of its kind",
            f"by chance in one of {_many(float(found.odd_p[at]))} boards",
            "look whether the part is damaged, is another one under that name, or is set otherwise",
            f"board:{found.boards.board[at]}",
        )
        for at in islice(order, BOARDS_NAMED)
    ]
    return _with_more(told, len(order), "odd", "boards are odd", "is:odd")


def _refused(found: Overview) -> list[Worry]:
    refused = found.boards.trust.count("refused")
    if not refused:
        return []
    return [
        Worry(
            "trust",
            f"{refused} boards' newest calibrations are refused",
            "their reasons and remedies stand in each document",
            "open the reports of these boards, and do what they say",
            "trust:refused",
        )
    ]


def _loose(found: Overview) -> list[Worry]:
    """Say which parameters the calibrations of a kind tell less of than the fleet does."""
    return [
        Worry(
            "prior",
            f"{_words(name)} of {int(one.prior_dominated.sum())} of {one.boards} {sensor} says "
            "less than the fleet",
            "calibrations leave more open than boards differ by: shrunk values are the fleet's",
            "record for longer, or by a program that tells more of it: `gyrorig plan`",
            f"is:prior sensor:{sensor}",
        )
        for (sensor, name), one in found.populations.items()
        if one.prior_dominated.mean() > 0.5
    ]


def _with_more(told: list[Worry], count: int, kind: str, words: str, find: str) -> list[Worry]:
    if count > len(told):
        told.append(Worry(kind, f"{count} {words}, {count - len(told)} more", "", "", find))
    return told


def unit_of(parameter: str) -> str:
    """Return the unit of a parameter's column, "" for a plain number."""
    family = parameter.split("_", maxsplit=1)[0]
    return {"bias": "rad/s", "misalignment": "rad", "time": "s"}.get(family, "")


def find_group(kind: str, name: str) -> str:
    """Return what to put into the page's search to see the boards of a group."""
    return f'{kind}:"{name}"' if " " in name else f"{kind}:{name}"


def _many(p: float) -> str:
    """Return how many boards one such comes on; tails further out mean nothing."""
    return f"{1.0 / p:.2g}" if p > 1e-12 else "more than a million million"


def _sized(parameter: str, size: float) -> str:
    unit = unit_of(parameter)
    return f"{size:+.4g}{' ' if unit else ''}{unit}"


def _named(kind: str, group: str) -> str:
    """Return a group's name with its kind, once."""
    return group if group.startswith(kind) else f"{kind} {group}"
