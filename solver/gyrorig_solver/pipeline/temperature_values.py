"""Bias and scale factor over temperature from values without times: tables and calibrations.

What to use when: `read_values` for the inputs, `with_temperature_curves` for the calibration.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version as installed_version
from pathlib import Path

import msgspec
import numpy as np

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.apply import read_calibration
from gyrorig_solver.calibration import CalibrationDocument, Parameter, TemperatureRecord
from gyrorig_solver.calibration.calibration_builder import UNKNOWN, curve_record, settings_sha256
from gyrorig_solver.calibration.calibration_document import (
    MODEL,
    BoardRecord,
    BoardSettings,
    Covariance,
    Matrices,
    ObservabilityRecord,
    Quality,
    SolvedInput,
    SolverRecord,
    Trust,
    Units,
    Validity,
)
from gyrorig_solver.calibration.reference_temperature import bias_temperature_degc
from gyrorig_solver.calibration.temperature_record import TemperaturePoint
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.utc_time import utc_text_now
from gyrorig_solver.estimate import TemperatureFit, fit_temperature
from gyrorig_solver.estimate.temperature import BiasTable
from gyrorig_solver.model import PARAMETER_GROUPS
from gyrorig_solver.pipeline.common_uncertainty import combined_uncertainty, judge_again
from gyrorig_solver.pipeline.temperature_table import AXES, read_table_rows, rounding_key

UNITS = {"rad/s": 1.0, "deg/s": float(np.pi / 180.0), "deg/h": float(np.pi / 648000.0)}
MIN_ROWS = 4
CALIBRATION_SUFFIXES = (".yaml", ".yml")
NO_MOTION_REASON = (
    "a table of biases does not show the gain. To know the gain, calibrate the board with a motion "
    "and give the calibration with --calibration"
)


@dataclass(frozen=True, slots=True, eq=False)
class TemperatureValues:
    """Bias and scale factor at temperatures, one row per measurement."""

    source: str
    temperature_degc: FloatArray  # (n,)
    bias: FloatArray  # (n, 3), rad/s
    bias_std: FloatArray  # (n, 3), not below that of rounding; zero if neither is known
    scale: FloatArray | None  # (n, 3); None if it is not given
    scale_std: FloatArray | None
    template: CalibrationDocument | None  # the last calibration among the inputs
    calibrations: tuple[CalibrationDocument, ...] = ()  # all of them
    is_from_calibrations: bool = False  # all values are


def read_values(paths: Sequence[Path], unit: str) -> TemperatureValues:
    """Return the rows of tables and calibrations.

    Args:
        paths: CSV tables, and calibrations (YAML) of one board.
        unit: of the bias in tables, a key of `UNITS`.

    Raises:
        InputError: a file is neither, or it lacks a value.
        UsageError: there are too few rows, or calibrations of several boards, or of one board with
            several settings.
    """
    rows: list[dict[str, float]] = []
    calibrations: list[CalibrationDocument] = []
    for number, path in enumerate(paths):
        if path.resolve() in [earlier.resolve() for earlier in paths[:number]]:
            raise UsageError(
                f"the file {path.name} is given twice",
                "give each file once, because values that count twice make the uncertainties too "
                "small",
            )
        if path.suffix in CALIBRATION_SUFFIXES:
            document, _ = read_calibration(path)
            for earlier_document in calibrations:
                check_same_calibrated_board(earlier_document.board, document.board)
            calibrations.append(document)
            rows.append(_calibration_row(document, path.name))
        else:
            rows += read_table_rows(path, UNITS[unit])
    if len(rows) < MIN_ROWS:
        raise UsageError(
            f"{len(rows)} values of the bias are too few for a curve against the temperature",
            f"give at least {MIN_ROWS} values at different temperatures",
        )
    bias, bias_std = _columns(rows, "bias")
    has_scale = all(f"scale_{axis}" in row for row in rows for axis in AXES)
    scale, scale_std = _columns(rows, "scale") if has_scale else (None, None)
    return TemperatureValues(
        ", ".join(path.name for path in paths),
        np.array([row["temperature_degc"] for row in rows]),
        bias,
        bias_std,
        scale,
        scale_std,
        calibrations[-1] if calibrations else None,
        tuple(calibrations),
        len(calibrations) == len(paths),
    )


def check_same_calibrated_board(board: BoardRecord, other: BoardRecord) -> None:
    """Check that two calibrations are of one board with the same settings.

    Raises:
        UsageError: id, uid, sensor or a setting differs; what is not known can be the same.
    """
    key = board.difference_from(other)
    if key is None:
        return
    pair = [
        getattr(record, key) if hasattr(record, key) else getattr(record.config, key)
        for record in (board, other)
    ]
    if key == "id":
        raise UsageError(
            f"the calibrations are of different boards, {pair[0]} and {pair[1]}",
            "give calibrations of one board",
        )
    raise UsageError(
        f"the {key} of board {board.id} is {str(pair[0])[:40]} in one calibration, and "
        f"{str(pair[1])[:40]} in another",
        "give calibrations of one board with the same settings",
    )


def _columns(rows: Sequence[dict[str, float]], name: str) -> tuple[FloatArray, FloatArray]:
    """Return the values of a quantity, (n, 3), and their uncertainties, at least of rounding."""
    value = np.array([[row[f"{name}_{axis}"] for axis in AXES] for row in rows])
    std = np.array([[row.get(f"{name}_std_{axis}", 0.0) for axis in AXES] for row in rows])
    _check_uncertainties(std, {"bias": "the bias", "scale": "the scale factor"}[name])
    rounding = np.array([[row.get(rounding_key(name), 0.0)] for row in rows])
    return value, np.maximum(std, rounding)


def _check_uncertainties(std: FloatArray, quantity: str) -> None:
    """Check that all values of an axis have an uncertainty, or none.

    The fit estimates a common scatter in addition to the known uncertainties, so a value without an
    uncertainty would have the largest weight.

    Raises:
        UsageError: some have it.
    """
    if ((std > 0.0).any(axis=0) & (std == 0.0).any(axis=0)).any():
        raise UsageError(
            f"some values of {quantity} have a standard uncertainty, and others have none",
            "give the uncertainties of all values, or of none",
        )


def _calibration_row(document: CalibrationDocument, name: str) -> dict[str, float]:
    degc = bias_temperature_degc(document)
    if document.validity.temperature_degc is None or degc is None:
        raise InputError(
            f"the calibration {name} has no temperature in degrees Celsius",
            "record the temperature of the board, and solve again",
        )
    row = {"temperature_degc": degc}
    for quantity in ("bias", "scale"):
        parameter = document.parameters[quantity]
        for axis, value, std in zip(
            AXES, _list(parameter.value), _list(parameter.std), strict=True
        ):
            if value is not None:
                row[f"{quantity}_{axis}"] = value
                row[f"{quantity}_std_{axis}"] = std or 0.0
    if not all(f"bias_{axis}" in row for axis in AXES):
        raise InputError(f"the calibration {name} has no value for the bias", "leave it out")
    return row


def _list(value: list[float | None] | float | None) -> list[float | None]:
    return value if isinstance(value, list) else [value] * len(AXES)


def with_temperature_curves(
    document: CalibrationDocument, values: TemperatureValues
) -> CalibrationDocument:
    """Return a calibration with the curves of bias and scale of the values.

    If all values are from calibrations that state a total uncertainty, the result states one, too.

    Raises:
        InputError: the values show no dependence on the temperature.
    """
    degc, template = values.temperature_degc, document
    bias = fit_temperature([], table=BiasTable(degc, values.bias, values.bias_std))
    if bias is None or not bias.is_significant:
        raise InputError(
            f"the bias in {values.source} does not depend significantly on the temperature",
            "use the mean of the bias, or measure over a larger range of temperatures",
        )
    document = _with_parameter(document, "bias", bias, "rad/s", np.ones(3))
    scale = None
    if values.scale is not None and values.scale_std is not None:
        mean = values.scale.mean(axis=0)
        table = BiasTable(degc, values.scale / mean, values.scale_std / np.abs(mean))
        scale = fit_temperature([], table=table)
    if scale is not None and scale.is_significant:
        document = _with_parameter(document, "scale", scale, "1", mean)
        document = _with_known_scale(document)
    record = TemperatureRecord(
        source=values.source,
        reference_degc=bias.reference_degc,
        range_degc=list(bias.range_degc),
        bias=curve_record(bias, "rad/s"),
        scale=None if scale is None or not scale.is_significant else curve_record(scale, "1"),
        repeatability=bias.run_std.tolist(),
        points=[
            TemperaturePoint(round(point.temperature_degc, 3), point.value.tolist())
            for point in bias.points
        ],
    )
    validity = Validity(
        document.validity.rate_rad_s, list(bias.range_degc), document.validity.config_hash
    )
    fitted = ["bias"] if record.scale is None else ["bias", "scale"]
    # Without the uncertainty of each value, that of the template is not stated, because it is about
    # its values at its own temperature.
    uncertainty = None
    if values.is_from_calibrations:
        uncertainty = combined_uncertainty(document, template, fitted, values.calibrations)
    trust = document.trust
    if uncertainty is not None:
        trust = judge_again(trust, template.uncertainty, uncertainty)
    return msgspec.structs.replace(
        document,
        inputs=_all_inputs([*values.calibrations, template]),
        temperature=record,
        validity=validity,
        uncertainty=uncertainty,
        trust=trust,
    )


def _all_inputs(calibrations: Sequence[CalibrationDocument]) -> list[SolvedInput]:
    """Return the recordings of all calibrations, each once."""
    rows = {row.sha256: row for document in calibrations for row in document.inputs}
    return list(rows.values())


def _with_known_scale(document: CalibrationDocument) -> CalibrationDocument:
    """Return a document in which the three scale factors count as determined."""
    before = document.observability
    hidden = [name for name in before.unobservable if not name.startswith("scale.")]
    rank = min(before.of, before.rank + len(before.unobservable) - len(hidden))
    return msgspec.structs.replace(
        document,
        matrices=_matrices(document),
        observability=msgspec.structs.replace(before, rank=rank, unobservable=hidden),
    )


def _with_parameter(
    document: CalibrationDocument, name: str, fit: TemperatureFit, unit: str, factor: FloatArray
) -> CalibrationDocument:
    """Return a document with the value at the reference temperature, and its uncertainty."""
    std = fit.std(np.array([fit.reference_degc]))[0] * np.abs(factor)
    parameter = Parameter(value=(fit.value * factor).tolist(), std=std.tolist(), unit=unit)
    entries = [f"{name}.{axis}" for axis in AXES]
    order = document.covariance.order
    order = [*order, *(entry for entry in entries if entry not in order)]
    before = np.array(document.covariance.matrix, dtype=np.float64)
    matrix = np.zeros((len(order), len(order)))
    matrix[: len(before), : len(before)] = before
    for entry, axis_std in zip(entries, std, strict=True):
        k = order.index(entry)
        matrix[k, :] = matrix[:, k] = 0.0
        matrix[k, k] = axis_std**2
    return msgspec.structs.replace(
        document,
        parameters={**document.parameters, name: parameter},
        covariance=Covariance(order, matrix.tolist()),
    )


def _matrices(document: CalibrationDocument) -> Matrices:
    """Return the matrices with the scale factors of the parameters."""
    scale = np.diag(np.array(document.parameters["scale"].value, dtype=np.float64))
    lower, rotation = (
        np.array(m, dtype=np.float64) for m in (document.matrices.T, document.matrices.M)
    )
    product = scale @ lower @ rotation
    if not np.all(np.isfinite(product)):
        return document.matrices
    return Matrices(scale.tolist(), document.matrices.T, document.matrices.M, product.tolist())


def document_without_motion(board: str, sensor: str) -> CalibrationDocument:
    """Return a calibration of a board that has only a bias, to be completed."""
    unknown = [None, None, None]
    units = {"bias": "rad/s", "scale": "1", "nonorthogonality": "1", "misalignment": "rad"}
    parameters = {name: Parameter(list(unknown), list(unknown), u) for name, u in units.items()}
    parameters["time_offset"] = Parameter(None, None, "s")
    order = [f"bias.{axis}" for axis in AXES]
    hidden = [
        f"{group.name}.{label}" if label else group.name
        for group in PARAMETER_GROUPS
        if group.name != "bias"
        for label in group.labels
    ]
    return CalibrationDocument(
        schema="gyrorig/calibration/1",
        board=BoardRecord(board, "unknown", sensor, BoardSettings()),
        version=1,
        created=utc_text_now(),
        inputs=[],
        solver=SolverRecord(
            installed_version("gyrorig"), "likelihood", ["bias"], settings_sha256({})
        ),
        units=Units(),
        model=MODEL,
        parameters=parameters,
        matrices=Matrices(UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN),
        covariance=Covariance(order, np.zeros((3, 3)).tolist()),
        observability=ObservabilityRecord(3, 12, hidden, None),
        noise={},
        quality=Quality(None, []),
        trust=Trust("limited", [NO_MOTION_REASON]),
        validity=Validity([0.0, 0.0]),
    )
