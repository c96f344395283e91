"""Parameter files for PX4 and ArduPilot.

What to use when: `px4_parameters`, `ardupilot_parameters`. Both autopilots use the offset of a gyro
and its dependence on temperature. Neither has a scale factor or a misalignment; the export leaves
them out and states this in the file. Both subtract the offset in the axes of their driver.

Sources: PX4 src/lib/sensor_calibration/Gyroscope.cpp (`_rotation * (data - thermal - offset)`),
its parameters TC_G0_*; ArduPilot AP_InertialSensor_Backend.cpp (`_rotate_and_correct_gyro`)
and AP_InertialSensor_tempcal.cpp (reference 35 degC, coefficients times 1e6, clamped to
TMIN..TMAX, and the value at the temperature of the offset's calibration added back).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.export.export_source import ExportSource, comment_lines

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
    lines = comment_lines("# ", source.header_lines())
    lines += [
        "#",
        "# rad/s, subtracted by PX4 from the rates of its driver (see `listener sensor_gyro`).",
        "# The file is right if that driver does not rotate the axes; else rotate the offsets.",
        "# PX4 has no gyro scale and no misalignment; those of this calibration are left out.",
        *comment_lines("# ", source.omission_lines(_carried_causes(source))),
        *comment_lines("# ", _curve_lines(source)),
    ]
    if device_id is None:
        lines.append(
            f"# PX4 uses them only for the device in CAL_GYRO{slot}_ID: check that it is this one."
        )
        lines += [
            f"# PX4 uses TC_G{slot}_* only if TC_G{slot}_ID is this device; --device-id writes it."
        ] * (_CubicBias.of(source) is not None)
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
    cubic = _CubicBias.of(source)
    if cubic is None:
        return
    stem = f"TC_G{slot}"
    yield "TC_G_ENABLE", 1, _INT32
    if device_id is not None:
        yield f"{stem}_ID", device_id, _INT32
    yield f"{stem}_TREF", cubic.reference_degc, _REAL32
    yield f"{stem}_TMIN", cubic.range_degc[0], _REAL32
    yield f"{stem}_TMAX", cubic.range_degc[1], _REAL32
    for order, row in enumerate([np.zeros(3), *cubic.coefficients]):
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
    lines = comment_lines("# ", source.header_lines())
    lines += [
        "#",
        "# rad/s, subtracted by ArduPilot from the rates in its sensor frame. The file is right if",
        "# the driver does not rotate the axes; otherwise rotate the three offsets.",
        "# INS_GYR_CAL is 0 because ArduPilot otherwise measures new offsets at every start.",
        "# ArduPilot has no gyro scale and no misalignment; those are left out.",
        *comment_lines("# ", source.omission_lines(_carried_causes(source))),
        *comment_lines("# ", _curve_lines(source)),
        "INS_GYR_CAL,0",
    ]
    lines += [
        f"{stem}_{axis},{bias:.9g}"
        for axis, bias in zip("XYZ", source.bias_rad_s.tolist(), strict=True)
    ]
    cubic = _CubicBias.of(source)
    if cubic is not None:
        moved = shift_polynomial(
            cubic.coefficients, cubic.reference_degc, _ARDUPILOT_REFERENCE_DEGC
        )
        number = slot + 1
        lines += [
            f"INS_TCAL{number}_ENABLE,1",
            f"INS_TCAL{number}_TMIN,{cubic.range_degc[0]:.2f}",
            f"INS_TCAL{number}_TMAX,{cubic.range_degc[1]:.2f}",
            f"INS_GYR{number}_CALTEMP,{cubic.reference_degc:.9g}",
        ]
        lines += [
            f"INS_TCAL{number}_GYR{order}_{axis},{value:.9g}"
            for order, row in enumerate(moved * _ARDUPILOT_FACTOR, start=1)
            for axis, value in zip("XYZ", row.tolist(), strict=True)
        ]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True, slots=True, eq=False)
class _CubicBias:
    """The bias over temperature in the form that both autopilots use."""

    coefficients: FloatArray  # (3, 3), of orders 1 to 3 for x, y, z, rad/s/K^p
    reference_degc: float
    range_degc: tuple[float, float]
    error_rad_s: float  # largest error, if the calibration has another curve

    @classmethod
    def of(cls, source: ExportSource) -> Self | None:
        """Return the cubic bias, None if the calibration has no curve or no range."""
        curve = source.bias_curve
        if curve is None or curve.is_zero or curve.range_degc is None:
            return None
        cubic, error = curve.as_cubic()
        padded = np.zeros((_POLYNOMIAL_ORDERS, 3))
        padded[: len(cubic.coefficients)] = cubic.coefficients
        return cls(padded, curve.reference_degc, curve.range_degc, float(error.max()))


def _curve_lines(source: ExportSource) -> list[str]:
    """Return remarks on the bias over temperature."""
    cubic = _CubicBias.of(source)
    if cubic is None:
        return []
    low, high = cubic.range_degc
    lines = [
        f"The bias follows the temperature from {low:.1f} to {high:.1f} degC. Outside, the",
        "autopilot uses the value at the nearer end.",
    ]
    if cubic.error_rad_s > 0.0:
        lines.append(
            f"The cubic polynomial differs from the calibration by at most {cubic.error_rad_s:.2g} "
            "rad/s."
        )
    return lines


def _carried_causes(source: ExportSource) -> tuple[str, ...]:
    """Return the exported causes; a polynomial needs an absolute temperature."""
    return () if _CubicBias.of(source) is None else ("thermal_bias",)


def shift_polynomial(polynomial: FloatArray, from_degc: float, to_degc: float) -> FloatArray:
    """Return the coefficients of p(T) - p(to) in powers of T - to, p in powers of T - from.

    Args:
        polynomial: orders 1, 2, ... along the first axis.
        from_degc: their reference temperature.
        to_degc: the new reference temperature.
    """
    out = np.zeros_like(polynomial)
    # Taylor's expansion about the new reference, by Horner's scheme for each order.
    work = np.concatenate([np.zeros((1, polynomial.shape[1])), polynomial])
    step = to_degc - from_degc
    for lowest in range(len(work) - 1):
        for upper, lower in pairwise(range(len(work) - 1, lowest - 1, -1)):
            work[lower] += step * work[upper]
    out[...] = work[1:]
    return out
