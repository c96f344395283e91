"""The section `temperature` of the calibration document: bias and scale against temperature.

What to use when: `temperature_record` to write it from a fit, `bias_curve` and `scale_curve` to use
it. It needs NumPy alone.
"""

from typing import Annotated, Literal

import msgspec
import numpy as np

from gyrorig_solver.data import TemperatureCurve

Triple = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
Pair = Annotated[list[float], msgspec.Meta(min_length=2, max_length=2)]


class _RecordPart(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Base of the parts of the section; unknown keys are errors."""


class CurveRecord(_RecordPart, frozen=True):
    """A quantity against the temperature, as change from its value at the reference temperature.

    The change is sum c_p (T - T0)^p + sum d_j (h_j(T) - h_j(T0)), with h_j(T) = max(T - k_j, 0)^3.
    """

    kind: Literal["polynomial", "spline"]
    unit: str  # of the quantity
    coefficients: list[Triple]  # c_1, c_2, ... of x, y, z, unit/K^p
    covariance: list[list[list[float]]]  # of x, y, z: c_1, ..., d_1, ..., then the value at T0
    knots_degc: list[float] = []
    knot_coefficients: list[Triple] = []  # d_1, ... of x, y, z, unit/K^3


class HysteresisRecord(_RecordPart, frozen=True):
    """The bias while the board heats minus that while it cools, at the same temperature, rad/s."""

    width: Triple
    std: Triple
    p_value: float  # small: there is a hysteresis
    fitted: bool  # whether it is part of the model of the fit; it is not applied


class TemperaturePoint(_RecordPart, frozen=True):
    """The mean bias of a part of the data, for figures, rad/s."""

    temperature_degc: float
    bias: Triple
    heating: bool | None = None  # None: not known


class TemperatureRecord(_RecordPart, frozen=True):
    """Bias and scale against temperature. `parameters` has their values at the reference."""

    source: str
    reference_degc: float
    range_degc: Pair  # valid range; a calibration is not applied outside
    bias: CurveRecord | None = None
    scale: CurveRecord | None = None  # of the scale factor relative to that at the reference
    lag_s: float = 0.0  # of the die behind the thermometer if below 0, ahead if above 0
    lag_std_s: float | None = None  # None: without times
    hysteresis: HysteresisRecord | None = None  # None: the data do not show both directions
    repeatability: Triple | None = None  # std of the bias from one recording or row to the next
    points: list[TemperaturePoint] = []


def bias_curve(record: TemperatureRecord | None) -> TemperatureCurve | None:
    """Return the curve of the bias, None if there is none."""
    return None if record is None or record.bias is None else _curve(record, record.bias)


def scale_curve(record: TemperatureRecord | None) -> TemperatureCurve | None:
    """Return the curve of the relative scale factor, None if there is none."""
    return None if record is None or record.scale is None else _curve(record, record.scale)


def _curve(record: TemperatureRecord, curve: CurveRecord) -> TemperatureCurve:
    return TemperatureCurve(
        record.reference_degc,
        np.array(curve.coefficients, dtype=np.float64).reshape(-1, 3),
        np.array(curve.knots_degc, dtype=np.float64),
        np.array(curve.knot_coefficients, dtype=np.float64).reshape(-1, 3),
        (record.range_degc[0], record.range_degc[1]),
    )
