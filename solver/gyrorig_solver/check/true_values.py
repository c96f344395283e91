"""Comparison of a calibration with the true values of an emulated rig, or with another one.

The emulator writes its true values to a separate document (`gyrorigd record --truth`). The
solver never reads it; the comparison does, after the solve.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.calibration.calibration_wording import value_std_pairs
from gyrorig_solver.data import FloatArray
from gyrorig_solver.model import PARAMETER_GROUPS, ParameterGroup, factorise, parameter_label


@dataclass(frozen=True, slots=True)
class ParameterComparison:
    """One parameter compared with its true value, in display units."""

    name: str
    estimate: float | None
    truth: float | None  # None: the other calibration has no value
    std: float | None
    unit: str
    total: float | None = None  # total standard uncertainty, None if not known

    @property
    def total_sigmas(self) -> float | None:
        """Difference in total standard uncertainties; None without them."""
        if self.estimate is None or self.truth is None or not self.total:
            return None
        return (self.estimate - self.truth) / self.total

    @property
    def sigmas(self) -> float | None:
        """Difference in standard uncertainties; None without two values."""
        if self.estimate is None or self.truth is None or not self.std:
            return None
        return (self.estimate - self.truth) / self.std


def compare_with_truth(
    calibration: CalibrationDocument, truth: Mapping[str, Any]
) -> list[ParameterComparison]:
    """Return each base parameter with its true value.

    Raises:
        InputError: the document has no usable values of that board.
    """
    try:
        board = truth["boards"][calibration.board.id]
        true_values = _true_values(board)
    except (KeyError, TypeError, ValueError, IndexError) as fault:
        raise InputError(
            f"the truth file does not contain the true values of board {calibration.board.id}",
            "give the truth file that `gyrorigd record --truth` wrote for this recording",
        ) from fault
    return [
        row
        for group in PARAMETER_GROUPS
        for row in _compare_group(calibration, group, true_values[group.name])
    ]


def _compare_group(
    calibration: CalibrationDocument, group: ParameterGroup, true_values: FloatArray
) -> Iterator[ParameterComparison]:
    estimates = value_std_pairs(calibration.parameters[group.name])
    totals = _totals(calibration)
    for label, (value, std), true_value in zip(group.labels, estimates, true_values, strict=True):
        yield ParameterComparison(
            name=parameter_label(group.name, label),
            estimate=None if value is None else value * group.factor,
            truth=float(true_value) * group.factor,
            std=None if std is None else std * group.factor,
            unit=group.unit,
            total=_scaled(totals.get(parameter_label(group.name, label)), group.factor),
        )


def _totals(calibration: CalibrationDocument) -> dict[str, float]:
    """Return the total standard uncertainty of each parameter that has one."""
    record = calibration.uncertainty
    return {} if record is None else {k: entry.total for k, entry in record.parameters.items()}


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def compare_calibrations(
    calibration: CalibrationDocument, other: CalibrationDocument
) -> list[ParameterComparison]:
    """Return each base parameter of two calibrations of one board.

    The standard uncertainty of a row is that of the difference, both taken as independent; None if
    a calibration does not state it.
    """
    rows = []
    totals, other_totals = _totals(calibration), _totals(other)
    for group in PARAMETER_GROUPS:
        pairs = zip(
            group.labels,
            value_std_pairs(calibration.parameters[group.name]),
            value_std_pairs(other.parameters[group.name]),
            strict=True,
        )
        for label, (value, std), (other_value, other_std) in pairs:
            name = parameter_label(group.name, label)
            both = name in totals and name in other_totals
            rows.append(
                ParameterComparison(
                    name=name,
                    estimate=_scaled(value, group.factor),
                    truth=_scaled(other_value, group.factor),
                    std=None
                    if std is None or other_std is None
                    else math.hypot(std, other_std) * group.factor or None,
                    unit=group.unit,
                    total=math.hypot(totals[name], other_totals[name]) * group.factor
                    if both
                    else None,
                )
            )
    return rows


def _true_values(board: Mapping[str, Any]) -> dict[str, FloatArray]:
    """Return the values of each group.

    Raises:
        KeyError, TypeError, ValueError: the document is not complete or not valid.
    """
    gain, bias = (
        np.array(entry, dtype=np.float64)
        for entry in (board["STM"], board.get("mean_bias_rad_s", board["bias_rad_s"]))
    )
    if gain.shape != (3, 3) or bias.shape != (3,):
        raise ValueError("not three values of the bias, or not three rows of three gains")
    factors = factorise(gain)
    return {
        "bias": bias,
        "scale": factors.scale,
        "nonorthogonality": factors.nonorthogonality,
        "misalignment": factors.misalignment_rad,
        "time_offset": np.array([_lag_s(board)]),
    }


def _lag_s(board: Mapping[str, Any]) -> float:
    """Return the total delay: latency before the low-pass filter plus its group delay at 0 Hz.

    A Butterworth filter of order 2 delays slow signals by sqrt(2) / (2 pi fc): the slope
    of its phase, -atan(sqrt(2) w / (1 - w^2)), at w = 0.
    """
    low_pass = board["low_pass"]
    if low_pass["kind"] != "butterworth" or low_pass["order"] != 2:
        raise ValueError("the low-pass filter is not a Butterworth filter of order 2")
    cutoff_hz = float(low_pass["cutoff_hz"])
    if not cutoff_hz > 0.0:
        raise ValueError("the cutoff frequency is not positive")
    return float(board["tau_s"]) + math.sqrt(2.0) / (2.0 * math.pi * cutoff_hz)
