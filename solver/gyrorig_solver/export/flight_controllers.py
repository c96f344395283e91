"""Parameter files for PX4 and ArduPilot.

What to use when: `px4_parameters`, `ardupilot_parameters`. Both autopilots take the offset of a
gyro and its dependence on temperature. Neither has a scale or a misalignment; those are left
out, and the file says so. Both subtract the offset in the axes that their driver reports.

Sources: PX4 src/lib/sensor_calibration/Gyroscope.cpp (`_rotation * (data - thermal - offset)`),
its parameters TC_G0_*; ArduPilot AP_InertialSensor_Backend.cpp (`_rotate_and_correct_gyro`)
and AP_InertialSensor_tempcal.cpp (reference 35 degC, coefficients times 1e6, clamped to
TMIN..TMAX, and the value at the temperature of the offset's calibration added back).
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.export.export_source import ExportSource

_REAL32, _INT32 = 9, 6  # MAV_PARAM_TYPE of MAVLink
_ARDUPILOT_REFERENCE_DEGC = 35.0
_ARDUPILOT_FACTOR = 1e6
_POLYNOMIAL_ORDERS = 3


def px4_parameters(source: ExportSource, slot: int = 0, device_id: int | None = None) -> str:
    """Return a QGroundControl parameter file for the gyro in CAL_GYRO<slot>.

    Args:
        source: a calibration with its bias.
        slot: 0 to 3.
        device_id: of the sensor, as shown by `param show CAL_GYRO0_ID`.

    Raises:
        InputError: the bias is not known.
    """
    lines = [f"# {line}" for line in source.header_lines()]
    lines += [
        "#",
        "# rad/s, subtracted by PX4 from the rates of its driver (see `listener sensor_gyro`).",
        "# The file is right if that driver does not rotate the axes; else rotate the offsets.",
        "# PX4 has no gyro scale and no misalignment; those of this calibration are left out.",
        *(f"# {line}" for line in source.omission_lines(_carried_causes(source))),
    ]
    if device_id is None:
        lines.append(
            f"# PX4 uses them only for the device in CAL_GYRO{slot}_ID: check that it is this one."
        )
    lines += ["#", "# Vehicle-Id Component-Id Name Value Type"]
    values: list[tuple[str, float, int]] = []
    if device_id is not None:
        values.append((f"CAL_GYRO{slot}_ID", device_id, _INT32))
    values += [
        (f"CAL_GYRO{slot}_{axis}OFF", bias, _REAL32)
        for axis, bias in zip("XYZ", source.bias_rad_s.tolist(), strict=True)
    ]
    values += _px4_thermal(source, slot, device_id)
    lines += [_px4_line(*value) for value in values]
    return "\n".join(lines) + "\n"


def _px4_thermal(
    source: ExportSource, slot: int, device_id: int | None
) -> Iterator[tuple[str, float, int]]:
    polynomial, reference, span = _thermal_polynomial(source)
    if polynomial is None or span is None:
        return
    stem = f"TC_G{slot}"
    yield "TC_G_ENABLE", 1, _INT32
    if device_id is not None:
        yield f"{stem}_ID", device_id, _INT32
    yield f"{stem}_TREF", reference, _REAL32
    yield f"{stem}_TMIN", span[0], _REAL32
    yield f"{stem}_TMAX", span[1], _REAL32
    for order, row in enumerate([np.zeros(3), *polynomial]):
        for axis, value in enumerate(row.tolist()):
            yield f"{stem}_X{order}_{axis}", value, _REAL32


def _px4_line(name: str, value: float, kind: int) -> str:
    text = str(int(value)) if kind == _INT32 else f"{value:.12g}"
    return f"1\t1\t{name}\t{text}\t{kind}"


def ardupilot_parameters(source: ExportSource, slot: int = 0) -> str:
    """Return a parameter file for the gyro of IMU number `slot` + 1.

    Raises:
        InputError: the bias is not known.
    """
    stem = "INS_GYROFFS" if slot == 0 else f"INS_GYR{slot + 1}OFFS"
    lines = [f"# {line}" for line in source.header_lines()]
    lines += [
        "#",
        "# rad/s, subtracted by ArduPilot from the rates in its sensor frame. The file is right if",
        "# the driver does not rotate the axes; otherwise rotate the three offsets.",
        "# INS_GYR_CAL is 0 because ArduPilot otherwise measures new offsets at every start.",
        "# ArduPilot has no gyro scale and no misalignment; those are left out.",
        *(f"# {line}" for line in source.omission_lines(_carried_causes(source))),
        "INS_GYR_CAL,0",
    ]
    lines += [
        f"{stem}_{axis},{bias:.9g}"
        for axis, bias in zip("XYZ", source.bias_rad_s.tolist(), strict=True)
    ]
    polynomial, reference, span = _thermal_polynomial(source)
    if polynomial is not None and span is not None:
        moved = (
            shift_polynomial(polynomial, reference, _ARDUPILOT_REFERENCE_DEGC) * _ARDUPILOT_FACTOR
        )
        number = slot + 1
        lines += [
            f"INS_TCAL{number}_ENABLE,1",
            f"INS_TCAL{number}_TMIN,{span[0]:.2f}",
            f"INS_TCAL{number}_TMAX,{span[1]:.2f}",
            f"INS_GYR{number}_CALTEMP,{reference:.9g}",
        ]
        lines += [
            f"INS_TCAL{number}_GYR{order}_{axis},{value:.9g}"
            for order, row in enumerate(moved, start=1)
            for axis, value in zip("XYZ", row.tolist(), strict=True)
        ]
    return "\n".join(lines) + "\n"


def _carried_causes(source: ExportSource) -> tuple[str, ...]:
    """Return the exported causes; a polynomial needs an absolute temperature."""
    polynomial, _, span = _thermal_polynomial(source)
    return ("thermal_bias",) if polynomial is not None and span is not None else ()


def _thermal_polynomial(
    source: ExportSource,
) -> tuple[FloatArray | None, float, list[float] | None]:
    """Return the bias polynomial of three orders, its reference and its valid range."""
    span = source.document.validity.temperature_degc
    if source.calibration is None or not source.correction.thermal_bias.size:
        return None, float("nan"), span
    coefficients = source.correction.thermal_bias
    padded = np.zeros((_POLYNOMIAL_ORDERS, 3))
    padded[: len(coefficients)] = coefficients
    return padded, source.correction.reference_degc, span


def shift_polynomial(polynomial: FloatArray, from_degc: float, to_degc: float) -> FloatArray:
    """Return the coefficients of p(T) - p(to) in powers of T - to, p in powers of T - from.

    Args:
        polynomial: orders 1, 2, ... along the first axis.
        from_degc: their reference temperature.
        to_degc: the new reference temperature.
    """
    out = np.zeros_like(polynomial)
    # Taylor's expansion about the new reference, by Horner's scheme: order by order.
    work = np.concatenate([np.zeros((1, polynomial.shape[1])), polynomial])
    step = to_degc - from_degc
    for lowest in range(len(work) - 1):
        for upper, lower in pairwise(range(len(work) - 1, lowest - 1, -1)):
            work[lower] += step * work[upper]
    out[...] = work[1:]
    return out
