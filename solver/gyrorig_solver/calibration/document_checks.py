"""Checks of a calibration document that the types of its fields cannot express.

A calibration can come from anyone, and other programs compile or load what is exported from it.
Names are therefore plain words, lists have their lengths, matrices agree with each other, and
numbers are within what a gyroscope can have.

What to use when: `check_document` after a document is parsed; `check_values` before its numbers are
used. It needs numpy alone.
"""

import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from gyrorig_protocol.errors import InputError

if TYPE_CHECKING:
    from gyrorig_solver.calibration.calibration_document import CalibrationDocument

# thermal_bias, thermal_bias.slope, lost_steps@2, lost_steps#3@2.pan
PARAMETER_NAME = re.compile(
    r"[A-Za-z][A-Za-z0-9_]{0,63}(#[0-9]{1,2})?(@[0-9]{1,4})?(\.[A-Za-z0-9_]{1,64})?"
)
# bias.x of recording 2 of board 1
_VALUE_NAME = re.compile(r"[A-Za-z0-9_.#@ ]{1,120}")
_CORRECT_NAME = "write a name with letters, digits and underscores, or solve the recording again"
_SOLVE_AGAIN = "correct the document, or solve the recording again"
_AXES = 3
_VECTORS = ("bias", "scale", "nonorthogonality", "misalignment")
_MAX_VALUE = 1e9  # of any parameter, in SI units
_MAX_BIAS_RAD_S = 1e3  # no gyroscope measures 57 000 deg/s
_MAX_DEGC = 1e3
GAIN_LIMITS = (1e-3, 1e3)  # of a scale factor relative to the nominal one
_CONSISTENCY = 1e-6  # S T M against STM, relative
# Limits of the settings of a board, from the smallest to the largest possible value.
SETTING_LIMITS = {
    "odr_hz": (1e-4, 1e6),
    "bandwidth_hz": (1e-6, 1e6),
    "gyro_full_scale_dps": (1e-3, 1e6),
    "gyro_scale_rad_s": (1e-12, 10.0),
}


def cause_of_parameter(name: str) -> str:
    """Return the part of a parameter's name that is the id of a cause or of a group of values."""
    return re.split("[.#@]", name, maxsplit=1)[0]


def check_document(document: "CalibrationDocument", name: str) -> None:
    """Check names and shapes of a calibration.

    Raises:
        InputError: a name is not a plain word, or a list has another length.
    """
    _reject(
        name,
        [
            *_name_problems(document),
            *_shape_problems(document),
            *_uncertainty_problems(document),
        ],
    )


def check_values(document: "CalibrationDocument", name: str) -> None:
    """Check that the numbers of a calibration can be those of a gyroscope.

    Raises:
        InputError: a number is outside what a gyroscope can have, or the matrices do not agree.
    """
    problems = [
        *_setting_problems(document),
        *_value_problems(document),
        *_range_problems(document),
    ]
    _reject(name, problems or list(_matrix_problems(document)))


def _reject(name: str, problems: Sequence[tuple[str, str]]) -> None:
    for problem, remedy in problems[:1]:
        raise InputError(f"the calibration {name} {problem}", remedy)


def _name_problems(document: "CalibrationDocument") -> Iterator[tuple[str, str]]:
    for names, pattern in (
        (document.parameters, PARAMETER_NAME),
        (document.noise, PARAMETER_NAME),
        (document.covariance.order, _VALUE_NAME),
        (document.observability.unobservable, _VALUE_NAME),
    ):
        for name in names:
            if not pattern.fullmatch(name):
                yield f"contains {name[:60]!r}, which is not the name of a parameter", _CORRECT_NAME


def _shape_problems(document: "CalibrationDocument") -> Iterator[tuple[str, str]]:
    for name in _VECTORS:
        if name in document.parameters:
            value = document.parameters[name].value
            if not isinstance(value, list) or len(value) != _AXES:
                yield f"does not have three values of {name}", _SOLVE_AGAIN
    offset = document.parameters.get("time_offset")
    if offset is not None and isinstance(offset.value, list):
        yield "has several values of time_offset", _SOLVE_AGAIN
    for name, figure in document.noise.items():
        if len(figure.value) != _AXES:
            yield f"does not have three values of {name}", _SOLVE_AGAIN
    for name, matrix in _matrices(document).items():
        if not _has_shape(matrix, (_AXES, _AXES)):
            yield f"does not have three rows of three numbers in {name}", _SOLVE_AGAIN


def _uncertainty_problems(document: "CalibrationDocument") -> Iterator[tuple[str, str]]:
    """Return the uncertainties whose shape is not that of their values."""
    for name, parameter in document.parameters.items():
        value, std = parameter.value, parameter.std
        count = len(value) if isinstance(value, list) else None
        if std is not None and (len(std) if isinstance(std, list) else None) != count:
            yield f"does not have one standard uncertainty for each value of {name}", _SOLVE_AGAIN
    if not _has_shape(document.covariance.matrix, (len(document.covariance.order),) * 2):
        yield "does not have one row and one column of its covariance per parameter", _SOLVE_AGAIN
    temperature = document.temperature
    for name, curve in (
        () if temperature is None else (("bias", temperature.bias), ("scale", temperature.scale))
    ):
        size = 0 if curve is None else len(curve.coefficients) + len(curve.knot_coefficients) + 1
        if curve is not None and (
            len(curve.knots_degc) != len(curve.knot_coefficients)
            or not _has_shape(curve.covariance, (_AXES, size, size))
        ):
            yield f"has a curve of {name} whose lists do not have the same size", _SOLVE_AGAIN


def _has_shape(nested: Sequence[Any], shape: tuple[int, ...]) -> bool:
    """Return whether nested lists have this number of entries at each level."""
    return len(nested) == shape[0] and (
        len(shape) == 1 or all(_has_shape(part, shape[1:]) for part in nested)
    )


def _setting_problems(document: "CalibrationDocument") -> Iterator[tuple[str, str]]:
    for key, (least, largest) in SETTING_LIMITS.items():
        value = getattr(document.board.config, key)
        if value is not None and not least <= value <= largest:
            yield (
                f"has the value {value:g} of {key}, which is not between {least:g} and {largest:g}",
                _SOLVE_AGAIN,
            )


def _value_problems(document: "CalibrationDocument") -> Iterator[tuple[str, str]]:
    for name, parameter in document.parameters.items():
        values = parameter.value if isinstance(parameter.value, list) else [parameter.value]
        limit = _MAX_BIAS_RAD_S if name == "bias" else _MAX_VALUE
        for value in values:
            if value is not None and abs(value) > limit:
                yield f"has the value {value:g} of {name}, which is too large", _SOLVE_AGAIN
    for name, figure in document.noise.items():
        for value in figure.value:
            if value is not None and not 0.0 <= value <= _MAX_VALUE:
                yield f"has the value {value:g} of {name}, which is not possible", _SOLVE_AGAIN


def _range_problems(document: "CalibrationDocument") -> Iterator[tuple[str, str]]:
    for key, limit in (("rate_rad_s", _MAX_VALUE), ("temperature_degc", _MAX_DEGC)):
        span = getattr(document.validity, key)
        if span is not None and not -limit <= span[0] <= span[1] <= limit:
            yield f"has a range {key} of its validity that is not possible", _SOLVE_AGAIN


def _matrix_problems(document: "CalibrationDocument") -> Iterator[tuple[str, str]]:
    rows = _matrices(document)
    if any(value is None for matrix in rows.values() for row in matrix for value in row):
        return
    scale, shear, rotation, gain = (np.array(matrix, dtype=np.float64) for matrix in rows.values())
    least, largest = GAIN_LIMITS
    factors = np.abs(np.diag(scale))
    if not (np.all(factors >= least) and np.all(factors <= largest)):
        yield f"has a scale factor that is not between {least:g} and {largest:g}", _SOLVE_AGAIN
    elif max(np.abs(matrix).max() for matrix in (scale, shear, rotation, gain)) > largest:
        yield f"has a matrix with a number above {largest:g}", _SOLVE_AGAIN
    elif (
        np.any(np.abs(scale - np.diag(np.diag(scale))) > _CONSISTENCY)
        or np.any(np.abs(np.triu(shear) - np.eye(_AXES)) > _CONSISTENCY)
        or np.any(np.abs(rotation @ rotation.T - np.eye(_AXES)) > _CONSISTENCY)
        or np.linalg.det(rotation) < 0.0
        or np.any(np.abs(scale @ shear @ rotation - gain) > _CONSISTENCY * np.abs(gain).max())
    ):
        yield (
            "has matrices that do not agree: S must be diagonal, T lower triangular with ones, M "
            "a rotation, and STM their product",
            _SOLVE_AGAIN,
        )
    # One reversed axis gives one negative factor. A pair of reversed axes is a rotation.
    elif np.count_nonzero(np.diag(scale) < 0.0) > 1:
        yield "has more than one negative scale factor", _SOLVE_AGAIN


def _matrices(document: "CalibrationDocument") -> dict[str, list[list[float | None]]]:
    matrices = document.matrices
    return {"S": matrices.S, "T": matrices.T, "M": matrices.M, "STM": matrices.STM}
