"""What was found beside what an emulated rig hides, in standard deviations.

The emulator writes its truth as a document of its own; nothing of it reaches the solver,
which has finished before this is read.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.calibration.document import Calibration
from gyrorig_solver.calibration.wording import GROUPS, Group, entries
from gyrorig_solver.model.gain import factorise


@dataclass(frozen=True, slots=True)
class Compared:
    """One parameter, in the unit that people read."""

    name: str
    found: float | None
    truth: float
    std: float | None
    unit: str

    @property
    def sigmas(self) -> float | None:
        """How far off, in standard deviations; None where nothing was found."""
        if self.found is None or not self.std:
            return None
        return (self.found - self.truth) / self.std


def compare(calibration: Calibration, truth: Mapping[str, Any]) -> list[Compared]:
    """Return each parameter of the base model beside the truth.

    Args:
        calibration: of one board.
        truth: the emulator's document.

    Raises:
        InputError: the document does not speak of that board.
    """
    try:
        board = truth["boards"][calibration.board.id]
        true_values = _true_values(board)
    except (KeyError, TypeError, ValueError, IndexError) as fault:
        raise InputError(
            f"the truth says nothing usable of board {calibration.board.id}",
            "give the file that --truth wrote with this recording",
        ) from fault
    return [row for group in GROUPS for row in _rows(calibration, group, true_values[group.name])]


def _rows(calibration: Calibration, group: Group, true: FloatArray) -> Iterator[Compared]:
    found = entries(calibration.parameters[group.name])
    for label, (value, std), real in zip(group.labels, found, true, strict=True):
        yield Compared(
            name=f"{group.name.replace('_', ' ')} {label}".strip(),
            found=None if value is None else value * group.factor,
            truth=float(real) * group.factor,
            std=None if std is None else std * group.factor,
            unit=group.unit,
        )


def _true_values(board: Mapping[str, Any]) -> dict[str, FloatArray]:
    factors = factorise(np.array(board["STM"], dtype=np.float64))
    bias = board.get("mean_bias_rad_s", board["bias_rad_s"])
    return {
        "bias": np.array(bias, dtype=np.float64),
        "scale": factors.scale,
        "nonorthogonality": factors.nonorthogonality,
        "misalignment": factors.misalignment_rad,
        "time_offset": np.array([_lag_s(board)]),
    }


def _lag_s(board: Mapping[str, Any]) -> float:
    """Return the whole lag: the delay before the low-pass, and the low-pass's own at 0 Hz.

    A Butterworth filter of order 2 delays slow signals by sqrt(2) / (2 pi fc): the slope
    of its phase, -atan(sqrt(2) w / (1 - w^2)), at w = 0.
    """
    low_pass = board["low_pass"]
    if low_pass["kind"] != "butterworth" or low_pass["order"] != 2:
        raise ValueError("a low-pass of another kind")
    return float(board["tau_s"]) + math.sqrt(2.0) / (2.0 * math.pi * float(low_pass["cutoff_hz"]))
