"""The correction of a calibration document: which of its parameters a reading needs, and which not.

What to use when: `build_correction` for the whole calibration, `build_bias_correction` to subtract
only the bias.
"""

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.apply.calibration_file import (
    APPLIED_PARAMETERS,
    ATTITUDE_TERMS,
    BASE_PARAMETERS,
)
from gyrorig_solver.apply.correction import Correction, Frame
from gyrorig_solver.calibration import (
    CalibrationDocument,
    Parameter,
    bias_curve,
    cause_of_parameter,
    scale_curve,
)
from gyrorig_solver.data import FloatArray, TemperatureCurve

THERMAL_BIAS_ORDERS = ("slope", "square", "cube")
LAG_NOTE = (
    "the lag of the die temperature is not applied, because the die is assumed to have the "
    "measured temperature"
)
HYSTERESIS_NOTE = (
    "the hysteresis of the bias is not applied, because it depends on the temperatures before the "
    "first reading"
)
BIAS_ONLY_NOTE = "the gain is not applied, because --bias-only keeps the nominal scale"
NO_REFERENCE_NOTE = (
    "thermal causes are not applied, because the calibration has no reference temperature. Solve "
    "again with this version"
)
REFERENCE_PARAMETER = "reference"  # thermal_bias.reference: the reference temperature
_MAX_CONDITION = 1e6  # above it the gain matrix cannot be inverted


def build_correction(calibration: CalibrationDocument, frame: Frame = "stage") -> Correction:
    """Return the correction of a calibration.

    Raises:
        InputError: the verdict is refused, or a needed parameter is not known.
    """
    name = f"{calibration.board.id} version {calibration.version}"
    _check_verdict(calibration, name)
    bias = _known_values(calibration, "bias", name)
    inverse = _inverse_gain(calibration, frame, name)
    not_applied: list[str] = []
    curves = _temperature_curves(calibration, not_applied)
    lag_s = _lag_s(calibration, curves[0], not_applied)
    force, force_notes = _g_sensitivity(calibration)
    not_applied += force_notes
    for parameter in calibration.parameters:
        cause = cause_of_parameter(parameter)
        if cause not in BASE_PARAMETERS and cause not in APPLIED_PARAMETERS:
            reason = ATTITUDE_TERMS.get(cause, "it describes the rig or one recording")
            not_applied.append(f"the parameter {parameter} is not applied, because {reason}")
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


def _check_verdict(calibration: CalibrationDocument, name: str) -> None:
    """Check that the solver did not refuse the calibration.

    Raises:
        InputError: it did.
    """
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
        InputError: the verdict is refused, or the bias is not known.
    """
    name = f"{calibration.board.id} version {calibration.version}"
    _check_verdict(calibration, name)
    zeros = np.zeros(3)
    not_applied = [BIAS_ONLY_NOTE]
    curve, _ = _temperature_curves(calibration, not_applied)
    return Correction(
        frame="sensor",
        inverse=np.eye(3),
        bias_rad_s=_known_values(calibration, "bias", name),
        bias_curve=curve,
        scale_curve=None,
        lag_s=_lag_s(calibration, curve, not_applied),
        quadratic=zeros,
        cubic=zeros,
        asymmetry=zeros,
        force=np.zeros((3, 3)),
        not_applied=tuple(dict.fromkeys(not_applied)),
    )


def _lag_s(
    calibration: CalibrationDocument, curve: TemperatureCurve | None, not_applied: list[str]
) -> float:
    """Return the lag of the die temperature, with a note; zero without a curve of the bias."""
    if curve is None:
        return 0.0
    lag = calibration.parameters.get("thermal_bias.lag")
    lag_s = 0.0
    if calibration.temperature is not None:
        lag_s = calibration.temperature.lag_s
    elif lag is not None:
        lag_s = float(_values_or_zero(lag, calibration, "thermal_bias.lag", 1)[0])
    not_applied += [LAG_NOTE] if lag_s else []
    return lag_s


def _temperature_curves(
    calibration: CalibrationDocument, not_applied: list[str]
) -> tuple[TemperatureCurve | None, TemperatureCurve | None]:
    """Return the curves of bias and scale: of the section `temperature`, else of the causes."""
    record = calibration.temperature
    bias, scale = bias_curve(record), scale_curve(record)
    if bias is not None and record and record.hysteresis and record.hysteresis.fitted:
        not_applied.append(HYSTERESIS_NOTE)
    orders = _thermal_bias_orders(calibration)
    slope = _optional_values(calibration, "thermal_scale")
    if bias is None and orders:
        bias = _polynomial(calibration, "thermal_bias", np.array(orders))
        not_applied += [NO_REFERENCE_NOTE] if bias is None else []
    if scale is None and slope.any():
        scale = _polynomial(calibration, "thermal_scale", slope[None])
        not_applied += [NO_REFERENCE_NOTE] if scale is None else []
    return bias, scale


def _polynomial(
    calibration: CalibrationDocument, cause: str, coefficients: FloatArray
) -> TemperatureCurve | None:
    """Return the curve of a thermal cause, None without a reference temperature."""
    reference = _reference_degc(calibration, cause)
    if reference is None:
        return None
    low_high = calibration.validity.temperature_degc
    valid_range = None if low_high is None else (low_high[0], low_high[1])
    return TemperatureCurve.polynomial(reference, coefficients, valid_range)


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


def _reference_degc(calibration: CalibrationDocument, cause: str) -> float | None:
    """Return the reference temperature of a thermal cause, else of the other; None without."""
    for entry in (cause, "thermal_bias", "thermal_scale"):
        parameter = calibration.parameters.get(f"{entry}.{REFERENCE_PARAMETER}")
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
