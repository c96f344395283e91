"""Units and number formats of parameters: one spelling and one unit each in all texts.

What to use when: `PARAMETER_GROUPS` for the base parameters in the order of the document;
`parameter_label` for the name of one value (`scale.x`); `display_unit` for any SI unit;
`format_quantity` for a value with its standard uncertainty; `format_short` for a number without it;
`plural` for a counted noun. Files keep SI units.
"""

import math
from dataclasses import dataclass

DEG_PER_RAD = 180.0 / math.pi
# From these typical sizes on, all values of a parameter have the larger unit.
MIN_PERCENT_RATIO, MIN_PLAIN_RATIO, MIN_SECONDS_S = 0.01, 0.5, 1.0

# SI unit: factor and unit for people. Sizes of causes and of parameters use the same table.
DISPLAY_UNITS = {
    "rad": (DEG_PER_RAD, "deg"),
    "rad/s": (DEG_PER_RAD, "deg/s"),
    "rad/s^2": (DEG_PER_RAD, "deg/s^2"),
    "rad/s/K": (DEG_PER_RAD, "deg/s/K"),
    "rad/s/(m/s^2)": (DEG_PER_RAD * 9.80665, "deg/s/g"),
    "s/rad": (1e6 / DEG_PER_RAD, "ppm s/deg"),
    "s^2/rad^2": (1e6 / DEG_PER_RAD**2, "ppm s^2/deg^2"),
    "s": (1e3, "ms"),
    "s^2": (1e6, "ppm s^2"),
    "1": (1e6, "ppm"),
    "1/K": (1e6, "ppm/K"),
}


@dataclass(frozen=True, slots=True)
class ParameterGroup:
    """One parameter of the document and how to show it."""

    name: str
    labels: tuple[str, ...]
    meaning: str
    factor: float  # from the document's unit to the displayed one
    unit: str


PARAMETER_GROUPS = (
    ParameterGroup("bias", ("x", "y", "z"), "zero-rate output", DEG_PER_RAD, "deg/s"),
    ParameterGroup(
        "scale", ("x", "y", "z"), "scale factor, as a ratio to the nominal one", 1.0, "1"
    ),
    ParameterGroup(
        "nonorthogonality", ("xy", "zx", "zy"), "angles between the sensor's axes", 1e3, "mrad"
    ),
    ParameterGroup(
        "misalignment",
        ("x", "y", "z"),
        "rotation from the reference to the sensor",
        DEG_PER_RAD,
        "deg",
    ),
    ParameterGroup("time_offset", ("",), "delay of the samples behind the motion", 1e3, "ms"),
)


def parameter_label(name: str, component: str = "") -> str:
    """Return the name of one value as every command, report and file spells it: `scale.x`."""
    return f"{name}.{component}" if component else name


def display_unit(unit: str, typical_size: float = 0.0) -> tuple[float, str]:
    """Return the factor from an SI unit to the displayed one, and that unit.

    Args:
        unit: the SI unit.
        typical_size: of the parameter. With a typical size of 1 % or more, a ratio is in %, and of
            0.5 or more a plain number; a time with a typical size of 1 s or more is in s.
    """
    if unit == "1" and typical_size >= MIN_PLAIN_RATIO:
        return 1.0, ""
    if unit == "1" and typical_size >= MIN_PERCENT_RATIO:
        return 100.0, "%"
    if unit == "s" and typical_size >= MIN_SECONDS_S:
        return 1.0, "s"
    return DISPLAY_UNITS.get(unit, (1.0, unit))


def group_of(parameter: str) -> ParameterGroup | None:
    """Return the group of a base parameter (`scale` or `scale.x`); None for any other name."""
    name = parameter.partition(".")[0]
    return next((group for group in PARAMETER_GROUPS if group.name == name), None)


def decimals_of_std(std: float) -> int:
    """Return the decimals that show two significant digits of `std`."""
    if not std > 0.0 or not math.isfinite(std):
        return 6
    return min(12, max(0, 1 - math.floor(math.log10(std))))


def format_quantity(value: float, std: float | None) -> tuple[str, str]:
    """Return the texts of a value and its standard deviation, with equally many decimals."""
    if std is None or not std > 0.0:
        return f"{value:+.6g}", "0" if std == 0.0 else "unknown"  # 0: chosen, not measured
    decimals = decimals_of_std(std)
    return f"{value:+.{decimals}f}", f"{std:.{decimals}f}"


def format_two_digits(std: float) -> str:
    """Return a standard uncertainty with two significant digits."""
    return f"{std:.{decimals_of_std(std)}f}"


def format_short(value: float) -> str:
    """Return a number with three significant digits, without an exponent if possible."""
    if value == 0.0:
        return "0"
    if 1e-4 <= abs(value) < 1e5:
        return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"
    return f"{value:.2e}"


def plural(count: int, noun: str, nouns: str = "") -> str:
    """Return "1 board", "3 boards"; `nouns` for an irregular plural."""
    return f"{count} {noun if count == 1 else nouns or noun + 's'}"
