"""Numbers in the metadata of a recording; the metadata are untrusted texts."""

import math
import re
from collections.abc import Mapping

from gyrorig_protocol.errors import InputError

# Python's float() also accepts underscores, other digits and spaces.
_DECIMAL_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]{1,4})?")
_LIMITS = {
    "gyro_scale_rad_s": (1e-12, 10.0),
    "gyro_rounding_rad_s": (1e-12, 10.0),
    "accel_scale_m_s2": (1e-12, 1e3),
    "tick_hz": (0.1, 1e10),
    "counter_bits": (1.0, 64.0),
    "bandwidth_hz": (1e-6, 1e6),
    "gyro_full_scale_dps": (1e-3, 1e6),
}
_OTHER_LIMITS = (1e-12, 1e12)


def positive_number(metadata: Mapping[str, str], key: str) -> float | None:
    """Return a metadata entry as a positive number, None if it is missing.

    Raises:
        InputError: the entry is not a positive decimal number, or is not possible.
    """
    text = metadata.get(key)
    if text is None or text == "":
        return None
    value = decimal_number(text)
    if value is None or value <= 0.0:
        raise InputError(
            f"the value {text[:40]!r} of {key} in the recording is not a positive number",
            "correct this key in the rig file or in the import map, and record or import again",
        )
    least, largest = _LIMITS.get(key, _OTHER_LIMITS)
    if not least <= value <= largest:
        raise InputError(
            f"the value {text[:40]!r} of {key} in the recording is not between {least:g} and "
            f"{largest:g}",
            "correct this key in the rig file or in the import map, and record or import again",
        )
    return value


def decimal_number(text: str) -> float | None:
    """Return the finite number of a text, None if it is not one."""
    value = float(text) if _DECIMAL_NUMBER.fullmatch(text) else math.nan
    return value if math.isfinite(value) else None
