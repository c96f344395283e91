"""Units of rates and accelerations in the names of columns.

What to use when: `rate_factor` and `accel_factor` for the three columns of a sensor whose table
has a header, but no description.
"""

import re
from collections.abc import Callable, Sequence

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.importers.measured_streams import STANDARD_GRAVITY_M_S2

# a unit is in brackets, or after a blank or an underscore; letters on both sides belong to a word
_RATE_UNITS = (
    (re.compile(r"(?<![a-z])m(?:dps|deg)(?:$|[^a-z])"), float(np.radians(1e-3))),
    (re.compile(r"(?<![a-z])deg|°|(?<![a-z])dps(?![a-z])"), float(np.radians(1.0))),
    (re.compile(r"(?<![a-z])mrad(?![a-z])"), 1e-3),
    (re.compile(r"(?<![a-z])rad(?![a-z])|(?<![a-z])(?:radian|rps(?![a-z]))"), 1.0),
)
_ACCEL_UNITS = (
    (re.compile(r"m\s*/\s*s|(?<![a-z])ms\^?-?2|(?<![a-z])m_s_?\^?2|(?<![a-z])mps2"), 1.0),
    (re.compile(r"[\[(_ ]\s*mg\s*[\])]?$"), 1e-3 * STANDARD_GRAVITY_M_S2),
    (re.compile(r"[\[(_ ]\s*g(?:'?s|[-_ ]?force)?\s*[\])]?$"), STANDARD_GRAVITY_M_S2),
)


def rate_factor(names: Sequence[str], notes: list[str]) -> float:
    """Return the factor from the columns of a gyroscope to rad/s.

    Args:
        names: of the columns x, y and z.
        notes: texts for a reader; is appended to if the names have no known unit.

    Raises:
        InputError: the columns have different units.
    """
    return _common_factor(names, lambda name: _factor(name, _RATE_UNITS), "rates", "rad/s", notes)


def accel_factor(names: Sequence[str], notes: list[str]) -> float:
    """Return the factor from the columns of an accelerometer to m/s^2; as `rate_factor`."""
    return _common_factor(
        names, lambda name: _factor(name, _ACCEL_UNITS), "accelerations", "m/s^2", notes
    )


def _factor(name: str, units: Sequence[tuple[re.Pattern[str], float]]) -> float | None:
    lower = name.strip().lower()
    return next((factor for pattern, factor in units if pattern.search(lower)), None)


def _common_factor(
    names: Sequence[str],
    factor_of: Callable[[str], float | None],
    quantity: str,
    unit: str,
    notes: list[str],
) -> float:
    factors = {factor_of(name) for name in names}
    if len(factors) > 1:
        raise InputError(
            f"the columns {', '.join(name[:40] for name in names)} have different units",
            "import the log with `gyrorig import csv` and a column map (--map)",
        )
    factor = factors.pop()
    if factor is None:
        notes.append(
            f"the header has no known unit of the {quantity}, so they are taken as {unit}; if "
            "this is wrong, import the log with `gyrorig import csv` and a column map (--map)"
        )
        return 1.0
    return factor
