"""The inverse sensor model: from readings of a board to true rates.

What to use when: `build_correction` for a document; `Correction.rates` for readings. The model
is that of the document, with u = G omega, k and s the changes of bias and scale with the
temperature T (polynomials or splines), and f the specific force:

    y = u (1 + s(T) + q u + c u^2) + a |u| + b + k(T) + K f

It is solved for u. Then omega = G^-1 u in the stage's axes, or (S T)^-1 u in the
orthogonalised axes of the sensor.

Causes of the pan-tilt unit and of a single recording do not act on later readings. They are
left out and listed in `Correction.not_applied`.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.apply.affine import Output, Readings, transform_readings
from gyrorig_solver.apply.calibration_file import APPLIED_PARAMETERS, BASE_PARAMETERS
from gyrorig_solver.calibration import CalibrationDocument, Parameter, bias_curve, scale_curve
from gyrorig_solver.data import BoolArray, FloatArray, TemperatureCurve

Frame = Literal["stage", "sensor"]
FRAMES: tuple[Frame, ...] = ("stage", "sensor")

THERMAL_BIAS_ORDERS = ("slope", "square", "cube")
LAG_NOTE = (
    "the lag of the die temperature is not applied, because the die is assumed to have the "
    "measured temperature"
)
REFERENCE_PARAMETER = "reference"  # thermal_bias.reference: the reference temperature
_NEWTON_STEPS = 4  # the non-linearity is below a tenth: three steps reach the last digit
_BLOCK_SAMPLES = 65536  # readings per block where the arithmetic needs several copies
_MAX_CONDITION = 1e6  # above it the gain matrix cannot be inverted


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """Coefficients of the inverse sensor model, in SI units.

    `not_applied` lists the parameters that do not apply to later readings, with the reason.
    """

    frame: Frame
    inverse: (
        FloatArray  # (3, 3), from bias-free readings in the sensor's axes to rates in the frame
    )
    bias_rad_s: FloatArray  # (3,)
    bias_curve: TemperatureCurve | None  # change of the bias, rad/s
    scale_curve: TemperatureCurve | None  # relative change of the scale factor
    quadratic: FloatArray  # (3,)
    cubic: FloatArray  # (3,)
    asymmetry: FloatArray  # (3,)
    force: FloatArray  # (3, 3), rad/s/(m/s^2), in the sensor's axes
    lag_s: float = 0.0  # of the die temperature, see model/board_temperature.py
    not_applied: tuple[str, ...] = ()

    @property
    def needs_temperature(self) -> bool:
        """Whether rates depend on the temperature."""
        return bool(self._curves)

    @property
    def _curves(self) -> list[TemperatureCurve]:
        curves = (self.bias_curve, self.scale_curve)
        return [curve for curve in curves if curve is not None and not curve.is_zero]

    @property
    def reference_degc(self) -> float:
        """The reference temperature; nan if rates do not depend on the temperature."""
        return self._curves[0].reference_degc if self._curves else float("nan")

    @property
    def temperature_range_degc(self) -> tuple[float, float] | None:
        """The temperatures to which the correction can be applied; None: not limited."""
        return self._curves[0].range_degc if self._curves else None

    def covers(self, temperature_degc: FloatArray) -> BoolArray:
        """Return at which temperatures the correction is valid, shape (n,)."""
        degc = np.asarray(temperature_degc, dtype=np.float64)
        covered = [curve.covers(degc) for curve in self._curves]
        return np.asarray(np.all([np.ones(degc.shape, dtype=np.bool_), *covered], axis=0))

    @property
    def needs_force(self) -> bool:
        """Whether rates depend on the specific force."""
        return bool(self.force.any())

    @property
    def is_nonlinear(self) -> bool:
        """Whether the reading is a non-linear function of the rate."""
        coefficients = (self.quadratic, self.cubic, self.asymmetry)
        varies = self.scale_curve is not None and not self.scale_curve.is_zero
        return varies or any(bool(values.any()) for values in coefficients)

    @property
    def is_affine(self) -> bool:
        """Whether a matrix and an offset are sufficient."""
        return not (self.is_nonlinear or self.needs_temperature or self.needs_force)

    def offset(self) -> FloatArray:
        """Return the offset of the affine form, shape (3,), rad/s."""
        return np.asarray(-self.inverse @ self.bias_rad_s, dtype=np.float64)

    def rates(
        self,
        readings: Readings,
        scale_rad_s: float = 1.0,
        temperature_degc: FloatArray | float | None = None,
        specific_force_m_s2: FloatArray | None = None,
        out: Output | None = None,
    ) -> Output:
        """Return the true rates of readings, shape (n, 3), rad/s.

        Args:
            readings: shape (n, 3); counts, or rad/s at the nominal scale.
            scale_rad_s: nominal scale factor of the readings' unit; 1 for rad/s.
            temperature_degc: per reading, shape (n,), or one for all.
            specific_force_m_s2: readings of the board's accelerometer, shape (n, 3).
            out: as in `affine.transform_readings`.

        Raises:
            UsageError: a needed temperature or force is not given.
        """
        if self.needs_temperature and temperature_degc is None:
            raise UsageError(
                "the calibration depends on the temperature, but no temperature is given",
                "give the temperature of the board, or solve the board again with `--extend none`",
            )
        if self.needs_force and specific_force_m_s2 is None:
            raise UsageError(
                "the calibration depends on the acceleration, but no accelerometer readings are "
                "given",
                "give the readings of the accelerometer, or solve the board again with "
                "`--extend none`",
            )
        if self.is_affine:
            return transform_readings(readings, scale_rad_s * self.inverse, self.offset(), out)
        count = readings.shape[0]
        rates = np.empty((count, 3)) if out is None else out
        for start in range(0, count, _BLOCK_SAMPLES):
            rows = slice(start, min(start + _BLOCK_SAMPLES, count))
            degc = self._temperatures(temperature_degc, rows)
            reading = readings[rows] * scale_rad_s - self.bias_rad_s
            if self.bias_curve is not None:
                reading -= self.bias_curve.change(degc)
            if specific_force_m_s2 is not None:
                reading -= specific_force_m_s2[rows] @ self.force.T
            rates[rows] = self._invert_nonlinearity(reading, degc) @ self.inverse.T
        return rates

    def _temperatures(self, temperature_degc: FloatArray | float | None, rows: slice) -> FloatArray:
        """Return the temperatures of rows, shape (n,) or (1,)."""
        if temperature_degc is None or not self.needs_temperature:
            return np.full(1, self.reference_degc)
        temperatures = np.asarray(temperature_degc, dtype=np.float64)
        return np.atleast_1d(temperatures if temperatures.ndim == 0 else temperatures[rows])

    def _invert_nonlinearity(self, reading: FloatArray, degc: FloatArray) -> FloatArray:
        """Solve reading = u (1 + s(T) + q u + c u^2) + a |u| for u, by Newton's method."""
        if not self.is_nonlinear:
            return reading
        linear_factor = np.ones((1, 3))
        if self.scale_curve is not None:
            linear_factor = 1.0 + self.scale_curve.change(degc)
        u = reading / linear_factor
        for _ in range(_NEWTON_STEPS):
            predicted = u * (linear_factor + self.quadratic * u + self.cubic * u * u)
            predicted += self.asymmetry * np.abs(u)
            slope = linear_factor + 2.0 * self.quadratic * u + 3.0 * self.cubic * u * u
            u = u - (predicted - reading) / (slope + self.asymmetry * np.sign(u))
        return u


def build_correction(calibration: CalibrationDocument, frame: Frame = "stage") -> Correction:
    """Return the correction of a calibration.

    Raises:
        InputError: the verdict is refused, or a needed parameter is not known.
    """
    name = f"{calibration.board.id} version {calibration.version}"
    if calibration.trust.verdict == "refused":
        reason = (
            calibration.trust.reasons[0]
            if calibration.trust.reasons
            else "read the report of the calibration for the reason"
        )
        raise InputError(
            f"the calibration of {name} must not be applied, because the solver gave it the "
            "verdict `refused`",
            reason,
        )
    bias = _known_values(calibration, "bias", name)
    inverse = _inverse_gain(calibration, frame, name)
    not_applied: list[str] = []
    curves = _temperature_curves(calibration, not_applied)
    lag_s = _lag_s(calibration, curves[0])
    not_applied += [LAG_NOTE] if lag_s else []
    force, force_notes = _g_sensitivity(calibration)
    not_applied += force_notes
    for parameter in calibration.parameters:
        cause = parameter.partition(".")[0].partition("@")[0]
        if cause not in BASE_PARAMETERS and cause not in APPLIED_PARAMETERS:
            not_applied.append(
                f"the parameter {parameter} is not applied, because it describes the rig or "
                "one recording"
            )
    return Correction(
        frame=frame,
        inverse=inverse,
        bias_rad_s=bias,
        bias_curve=curves[0],
        scale_curve=curves[1],
        quadratic=_optional_values(calibration, "scale_quadratic"),
        cubic=_optional_values(calibration, "scale_cubic"),
        asymmetry=_optional_values(calibration, "scale_asymmetry"),
        force=force,
        lag_s=lag_s,
        not_applied=tuple(dict.fromkeys(not_applied)),
    )


def _inverse_gain(calibration: CalibrationDocument, frame: Frame, name: str) -> FloatArray:
    """Return the inverse of G, or of S T for the orthogonalised axes of the sensor."""
    matrices = calibration.matrices
    rows = [matrices.STM] if frame == "stage" else [matrices.S, matrices.T]
    if any(value is None for matrix in rows for row in matrix for value in row):
        unobservable = unobservable_text(calibration)
        raise InputError(
            f"the calibration of {name} has no value for {unobservable}",
            "record a motion that determines the parameter, or subtract only the bias with "
            "--bias-only",
        )
    gain = np.linalg.multi_dot([*(np.array(m, dtype=np.float64) for m in rows), np.eye(3)])
    if np.linalg.cond(gain) > _MAX_CONDITION:
        raise InputError(
            f"the calibration of {name} cannot be applied, because two of its gyro axes "
            "measure the same rate",
            "record a motion about all three axes and solve again",
        )
    return np.asarray(np.linalg.inv(gain), dtype=np.float64)


def unobservable_text(calibration: CalibrationDocument) -> str:
    """Return the names of the unobservable parameters, as text."""
    groups = (name.partition(".")[0] for name in calibration.observability.unobservable)
    return ", ".join(dict.fromkeys(groups)) or "the gain"


def build_bias_correction(calibration: CalibrationDocument) -> Correction:
    """Return a correction that subtracts the bias and keeps the nominal scale.

    Raises:
        InputError: the calibration determines nothing, or not the bias.
    """
    name = f"{calibration.board.id} version {calibration.version}"
    if calibration.trust.verdict == "refused" and calibration.observability.rank == 0:
        raise InputError(
            f"the calibration of {name} has no value for any parameter, so it cannot be applied",
            "read the report of the calibration for the reason, record a motion about all "
            "three axes, and solve again",
        )
    zeros = np.zeros(3)
    curve, _ = _temperature_curves(calibration, [])
    return Correction(
        frame="sensor",
        inverse=np.eye(3),
        bias_rad_s=_known_values(calibration, "bias", name),
        bias_curve=curve,
        scale_curve=None,
        lag_s=_lag_s(calibration, curve),
        quadratic=zeros,
        cubic=zeros,
        asymmetry=zeros,
        force=np.zeros((3, 3)),
        not_applied=("the gain is not applied, because --bias-only keeps the nominal scale",),
    )


def _lag_s(calibration: CalibrationDocument, curve: TemperatureCurve | None) -> float:
    """Return the lag of the die temperature; zero without a curve of the bias."""
    if curve is None:
        return 0.0
    if calibration.temperature is not None:
        return calibration.temperature.lag_s
    lag = calibration.parameters.get("thermal_bias.lag")
    if lag is None:
        return 0.0
    return float(_values_or_zero(lag, calibration, "thermal_bias.lag", 1)[0])


def _temperature_curves(
    calibration: CalibrationDocument, not_applied: list[str]
) -> tuple[TemperatureCurve | None, TemperatureCurve | None]:
    """Return the curves of bias and scale: of the section `temperature`, else of the causes."""
    record = calibration.temperature
    bias, scale = bias_curve(record), scale_curve(record)
    reference = _reference_degc(calibration)
    orders = _thermal_bias_orders(calibration)
    slope = _optional_values(calibration, "thermal_scale")
    if reference is None:
        if orders or slope.any():
            not_applied.append(
                "thermal causes are not applied, because the calibration has no reference "
                "temperature. Solve again with this version"
            )
        return bias, scale
    low_high = calibration.validity.temperature_degc
    valid_range = None if low_high is None else (low_high[0], low_high[1])
    if bias is None and orders:
        bias = TemperatureCurve.polynomial(reference, np.array(orders), valid_range)
    if scale is None and slope.any():
        scale = TemperatureCurve.polynomial(reference, slope[None], valid_range)
    return bias, scale


def _thermal_bias_orders(calibration: CalibrationDocument) -> list[FloatArray]:
    """Return the coefficients of the cause `thermal_bias`, the lowest order first."""
    orders: list[FloatArray] = []
    for order in THERMAL_BIAS_ORDERS:
        parameter = calibration.parameters.get(f"thermal_bias.{order}")
        if (
            order == THERMAL_BIAS_ORDERS[0] and parameter is None
        ):  # a cause with one size has no suffix
            parameter = calibration.parameters.get("thermal_bias")
        if parameter is None:
            break
        orders.append(_values_or_zero(parameter, calibration, f"thermal_bias.{order}"))
    return orders


def _reference_degc(calibration: CalibrationDocument) -> float | None:
    """Return the reference temperature of the thermal causes, None if there is none."""
    for cause in ("thermal_bias", "thermal_scale"):
        parameter = calibration.parameters.get(f"{cause}.{REFERENCE_PARAMETER}")
        if parameter is not None:
            value = parameter.value
            first = value[0] if isinstance(value, list) and value else value
            return None if isinstance(first, list) else first
    return None


def _g_sensitivity(calibration: CalibrationDocument) -> tuple[FloatArray, list[str]]:
    """Return K in the sensor's axes, K M^T, and a note if a part of it is not known."""
    parameter = calibration.parameters.get("g_sensitivity")
    misalignment = np.array(calibration.matrices.M, dtype=np.float64)
    if parameter is None or not np.all(np.isfinite(misalignment)):
        return np.zeros((3, 3)), []
    stage = _values_or_zero(parameter, calibration, "g_sensitivity", 9).reshape(3, 3)
    is_partial = isinstance(parameter.value, list) and None in parameter.value
    words = (
        "g_sensitivity along the stage's x axis is set to 0, because the motion of the recording "
        "did not show it"
    )
    return stage @ misalignment.T, [words] if is_partial else []


def _known_values(calibration: CalibrationDocument, parameter: str, name: str) -> FloatArray:
    """Return the three values of a base parameter.

    Raises:
        InputError: one of them is null.
    """
    value = calibration.parameters[parameter].value
    values = value if isinstance(value, list) else [value]
    if any(v is None for v in values):
        raise InputError(
            f"the calibration of {name} has no value for {parameter}",
            "record the motion that the report of the calibration recommends, and solve again",
        )
    return np.array(values, dtype=np.float64)


def _optional_values(calibration: CalibrationDocument, cause: str) -> FloatArray:
    """Return a cause's three values, zeros where it was not fitted.

    Raises:
        InputError: the cause has another number of values.
    """
    parameter = calibration.parameters.get(cause)
    return np.zeros(3) if parameter is None else _values_or_zero(parameter, calibration, cause)


def _values_or_zero(
    parameter: Parameter, calibration: CalibrationDocument, name: str, count: int = 3
) -> FloatArray:
    """Return a parameter's values, zero where one is null.

    Raises:
        InputError: the parameter has another number of values.
    """
    value = parameter.value if isinstance(parameter.value, list) else [parameter.value]
    if len(value) != count:
        raise InputError(
            f"the calibration of {calibration.board.id} has {len(value)} values of {name} instead "
            f"of {count}",
            "correct the document, or solve the recording again",
        )
    return np.array([0.0 if v is None else v for v in value], dtype=np.float64)
