"""The formats by name, and one function for all of them."""

import json
from dataclasses import dataclass
from typing import Any

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.calibration.document import to_plain
from gyrorig_solver.export.c_header import c_header
from gyrorig_solver.export.flight import ardupilot_parameters, px4_parameters
from gyrorig_solver.export.kalibr import kalibr_imu
from gyrorig_solver.export.numbers import AXES, Source
from gyrorig_solver.export.ros import ros_parameters

FORMATS = ("c", "ros", "kalibr", "px4", "ardupilot", "json")
SCHEMA = "gyrorig/export/1"
_NAMED = ("c", "ros", "kalibr")
_SLOTTED = {"px4": 4, "ardupilot": 3}


@dataclass(frozen=True, slots=True)
class Wishes:
    """What a person may say about an export."""

    name: str | None = None  # c: what names begin with; ros: the node; kalibr: the topic
    slot: int | None = None  # px4, ardupilot: which gyro of the vehicle, from 0
    device_id: int | None = None  # px4


def exported(source: Source, kind: str, wishes: Wishes | None = None) -> str:
    """Return a calibration's text in one of the formats.

    Raises:
        InputError: the calibration does not hold what the format needs.
        UsageError: there is no such format, or a wish that it does not know.
    """
    asked = wishes or Wishes()
    if kind not in FORMATS:
        raise UsageError(f"there is no format {kind!r:.40}", f"give one of {', '.join(FORMATS)}")
    if asked.name is not None and kind not in _NAMED:
        raise UsageError(f"{kind} has no place for a name", "leave out --name")
    if asked.slot is not None and not 0 <= asked.slot < _SLOTTED.get(kind, 0):
        most = _SLOTTED.get(kind)
        remedy = "leave out --slot" if most is None else f"give --slot 0 to {most - 1}"
        raise UsageError(f"{kind} has no gyro {asked.slot}", remedy)
    if asked.device_id is not None and kind != "px4":
        raise UsageError(f"{kind} has no place for a device's number", "leave out --device-id")
    if source.frame == "sensor" and kind in _SLOTTED:
        raise UsageError(
            f"{kind} turns no rates: its offsets are always in the sensor's own axes",
            "leave out --frame",
        )
    match kind:
        case "c":
            return c_header(source, asked.name)
        case "ros":
            return ros_parameters(source, asked.name)
        case "kalibr":
            return kalibr_imu(source, asked.name)
        case "px4":
            return px4_parameters(source, asked.slot or 0, asked.device_id)
        case "ardupilot":
            return ardupilot_parameters(source, asked.slot or 0)
        case _:
            return json_text(source)


def json_text(source: Source) -> str:
    """Return the numbers to apply, with their conventions, and the whole document."""
    plain: dict[str, Any] = {
        "schema": SCHEMA,
        "board": source.found.board.id,
        "version": source.found.version,
        "digest": source.digest or None,
        "conventions": {
            "rate": "rate = inverse_gain (reading - bias), rad/s; rows first, columns in",
            "reading": "counts times nominal_scale_rad_s, in the sensor's own axes",
            "axes": AXES[source.frame],
            "time": "time of the motion = time of the sample - time_offset_s",
        },
        "frame": source.frame,
        "nominal_scale_rad_s": source.found.board.config.gyro_scale_rad_s,
        "bias_rad_s": source.bias_rad_s.tolist(),
        "inverse_gain": None if source.gain is None else source.whole.inverse.tolist(),
        "time_offset_s": source.time_offset_s,
        "not_applied": [] if source.gain is None else list(source.whole.not_applied),
        "calibration": to_plain(source.found),
    }
    return json.dumps(plain, indent=1, allow_nan=False) + "\n"
