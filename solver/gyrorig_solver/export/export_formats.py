"""The export formats by name, and one function for all of them."""

import json
from dataclasses import dataclass
from typing import Any

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.apply import Correction
from gyrorig_solver.calibration import calibration_as_mapping
from gyrorig_solver.export.c_header import c_header
from gyrorig_solver.export.export_source import ExportSource
from gyrorig_solver.export.flight_controllers import ardupilot_parameters, px4_parameters
from gyrorig_solver.export.kalibr import kalibr_imu
from gyrorig_solver.export.ros import ros_parameters

FORMATS = ("c", "ros", "kalibr", "px4", "ardupilot", "json")
SCHEMA = "gyrorig/export/1"
_FORMATS_WITH_NAME = ("c", "ros", "kalibr")
_GYRO_SLOTS = {"px4": 4, "ardupilot": 3}


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of an export."""

    name: str | None = None  # c: prefix of names; ros: node; kalibr: topic
    slot: int | None = None  # px4, ardupilot: index of the gyro in the vehicle, from 0
    device_id: int | None = None  # px4


def export_text(source: ExportSource, kind: str, options: ExportOptions | None = None) -> str:
    """Return the text of a calibration in one of the formats.

    Raises:
        InputError: the calibration lacks data that the format needs.
        UsageError: the format is unknown, or it does not have a given option.
    """
    chosen = options or ExportOptions()
    if kind not in FORMATS:
        raise UsageError(
            f"the export format {kind!r:.40} is unknown",
            f"choose one of the formats {', '.join(FORMATS)}",
        )
    if chosen.name is not None and kind not in _FORMATS_WITH_NAME:
        raise UsageError(
            f"the export format {kind} does not use the option --name", "remove the option --name"
        )
    if chosen.slot is not None and kind not in _GYRO_SLOTS:
        raise UsageError(
            f"the export format {kind} does not use the option --slot", "remove the option --slot"
        )
    if chosen.slot is not None and not 0 <= chosen.slot < _GYRO_SLOTS[kind]:
        raise UsageError(
            f"the option --slot gives the gyro number {chosen.slot}, but the export format {kind} "
            f"has only {_GYRO_SLOTS[kind]} gyros",
            f"give a number from 0 to {_GYRO_SLOTS[kind] - 1} with --slot",
        )
    if chosen.device_id is not None and kind != "px4":
        raise UsageError(
            f"the export format {kind} does not use the option --device-id",
            "remove the option --device-id",
        )
    if source.frame == "sensor" and kind in _GYRO_SLOTS:
        raise UsageError(
            f"the export format {kind} contains only offsets in the sensor's own axes, so "
            "--frame has no effect",
            "remove the option --frame",
        )
    match kind:
        case "c":
            return c_header(source, chosen.name)
        case "ros":
            return ros_parameters(source, chosen.name)
        case "kalibr":
            return kalibr_imu(source, chosen.name)
        case "px4":
            return px4_parameters(source, chosen.slot or 0, chosen.device_id)
        case "ardupilot":
            return ardupilot_parameters(source, chosen.slot or 0)
        case _:
            return json_text(source)


def _terms_left_out(correction: Correction) -> list[str]:
    """Return what the formula `rate = inverse_gain (reading - bias)` leaves out."""
    terms = {
        "the change of the bias with the temperature": correction.bias_curve is not None,
        "the change of the scale factor with the temperature": correction.scale_curve is not None,
        "the error by the square of the rate": correction.quadratic.any(),
        "the error by the cube of the rate": correction.cubic.any(),
        "the asymmetry of the scale factor": correction.asymmetry.any(),
        "the sensitivity to acceleration": correction.needs_force,
    }
    left_out = [
        f"{term} is not applied, because the formula has a constant bias and gain"
        for term, is_present in terms.items()
        if is_present
    ]
    return [*correction.not_applied, *left_out]


def json_text(source: ExportSource) -> str:
    """Return the numbers to apply, with their conventions, and the complete document."""
    plain: dict[str, Any] = {
        "schema": SCHEMA,
        "board": source.document.board.id,
        "version": source.document.version,
        "digest": source.digest or None,
        "conventions": {
            "rate": "rate = inverse_gain (reading - bias), rad/s; rows first, columns in",
            "reading": "counts times nominal_scale_rad_s, in the sensor's own axes",
            "axes": source.axes_text,
            "time": "time of the motion = time of the sample - time_offset_s",
        },
        "frame": source.frame,
        "nominal_scale_rad_s": source.document.board.config.gyro_scale_rad_s,
        "bias_rad_s": source.bias_rad_s.tolist(),
        "inverse_gain": None if source.calibration is None else source.correction.inverse.tolist(),
        "time_offset_s": source.time_offset_s,
        "not_applied": list(source.not_applied)
        if source.calibration is None
        else _terms_left_out(source.correction),
        "calibration": calibration_as_mapping(source.document),
    }
    return json.dumps(plain, indent=1, allow_nan=False) + "\n"
