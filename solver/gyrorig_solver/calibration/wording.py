"""How a calibration's numbers are named and written for a person.

What to use when: `GROUPS` for the parameters in the order of the contract with the unit a
person thinks in; `quantity` for a value with as many digits as its uncertainty allows.
Files keep SI units; degrees stand only here and where people read.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from gyrorig_solver.calibration.document import Calibration, Parameter
from gyrorig_solver.model.terms.catalogue import catalogue

_DEG = 180.0 / math.pi


@dataclass(frozen=True, slots=True)
class Group:
    """One parameter of the document and how to show it."""

    name: str
    labels: tuple[str, ...]
    meaning: str
    factor: float  # from the document's unit to the one shown
    unit: str


GROUPS = (
    Group("bias", ("x", "y", "z"), "what it reads at rest", _DEG, "deg/s"),
    Group("scale", ("x", "y", "z"), "its sensitivity beside the nominal one", 1.0, "1"),
    Group("nonorthogonality", ("xy", "zx", "zy"), "its axes against each other", 1e3, "mrad"),
    Group("misalignment", ("x", "y", "z"), "how it sits on the stage", _DEG, "deg"),
    Group("time_offset", ("",), "its samples behind the motion", 1e3, "ms"),
)

VERDICTS = {
    "good": ("Good", "Every parameter was observable, and what is left looks like noise."),
    "limited": ("Limited", "Use the values that are given, and mind what follows."),
    "refused": ("Refused", "Do not use it before what follows is mended."),
}

# What a terminal says next; a report has a section of its own for it.
NEXT = {
    "good": "put it to use with `gyrorig apply` or `gyrorig export`; look at the report.",
    "limited": "do what the lines with ! say, record again and solve both recordings together.",
    "refused": "do what the lines with ! say, and record again.",
}


def nothing_text(calibration: Calibration) -> str:
    """Return what to say in the place of a value that is null."""
    if calibration.solver.method == "paper":
        return "no result by the paper's method"
    return "not observable from this motion"


def collapsed(names: Sequence[str]) -> list[str]:
    """Return parameter names with a whole group written as one: `scale` for its three."""
    out = []
    for group in GROUPS:
        whole = [f"{group.name}.{label}" for label in group.labels if label] or [group.name]
        there = [name for name in whole if name in names]
        out += [group.name] if len(there) == len(whole) else there
    return out + [name for name in names if name.split(".")[0] not in {g.name for g in GROUPS}]


def other_groups(calibration: Calibration) -> tuple[Group, ...]:
    """Return the extension terms of a document, which come after the base model's."""
    base = {group.name for group in GROUPS}
    return tuple(
        Group(name, _labels(name, len(entries(p))), "beyond the base model", 1.0, p.unit)
        for name, p in calibration.parameters.items()
        if name not in base
    )


def _labels(name: str, count: int) -> tuple[str, ...]:
    """Return what each value of a cause's parameter belongs to: `cause` or `cause.parameter`."""
    cause, _, own = name.partition(".")
    known = catalogue()[cause].parameters if cause in catalogue() else ()
    for parameter in known:
        if own in ("", parameter.name) and len(parameter.parts) == count:
            return parameter.parts
    return {1: ("",), 3: ("x", "y", "z")}.get(count, tuple(str(i) for i in range(count)))


def entries(parameter: Parameter) -> list[tuple[float | None, float | None]]:
    """Return (value, standard deviation) of each entry, in the document's unit."""
    value, std = parameter.value, parameter.std
    values = value if isinstance(value, list) else [value]
    stds = std if isinstance(std, list) else [std]
    return list(zip(values, stds, strict=True))


def digits(std: float) -> int:
    """Return the decimals that show two significant digits of `std`."""
    if not std > 0.0 or not math.isfinite(std):
        return 6
    return min(12, max(0, 1 - math.floor(math.log10(std))))


def quantity(value: float, std: float | None) -> tuple[str, str]:
    """Return the texts of a value and its standard deviation, equally many decimals."""
    if std is None or not std > 0.0:
        return f"{value:+.6g}", "0" if std == 0.0 else "unknown"  # 0: chosen, not measured
    places = digits(std)
    return f"{value:+.{places}f}", f"{std:.{places}f}"


def level_words(
    tilt_zero_rad: tuple[float, float],
    lean_rad: Sequence[float],
    lean_std_rad: Sequence[float],
    rests: int,
) -> str:
    """Return how the unit stands by the board's accelerometer.

    Args:
        tilt_zero_rad: value and standard deviation.
        lean_rad: of the pan axis, to the right and forward.
        lean_std_rad: the same's standard deviations.
        rests: in which it was seen.
    """
    tilt, right, forward = (
        " ± ".join(quantity(math.degrees(value), math.degrees(std)))
        for value, std in (tilt_zero_rad, *zip(lean_rad, lean_std_rad, strict=True))
    )
    return (
        f"By the board's accelerometer in {rests} rests: the zero of tilt, less how the board sits "
        f"about x, is at {tilt}°; the pan axis leans by {right}° to the right and {forward}° "
        "forward."
    )


def short(value: float) -> str:
    """Return a number with three significant digits, without an exponent where it can."""
    if value == 0.0:
        return "0"
    if 1e-4 <= abs(value) < 1e5:
        return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"
    return f"{value:.2e}"
