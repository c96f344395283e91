"""The calibration of one board, for use in Python: arrays in, arrays out.

    from gyrorig_solver import Calibration

    calibration = Calibration.load("calibrations/GY80-1/v0001.yaml")
    rates = calibration.rates(counts)          # (n, 3) counts to (n, 3) rad/s
    times = calibration.times(stamps)          # time of the motion

It needs numpy and nothing of the extra `solver`.
"""

from pathlib import Path
from typing import Literal, Self

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.apply.affine import Output, Readings
from gyrorig_solver.apply.calibration_correction import (
    build_bias_correction,
    build_correction,
)
from gyrorig_solver.apply.calibration_file import check_parameters, read_calibration
from gyrorig_solver.apply.correction import (
    Correction,
    Frame,
)
from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.data import FloatArray

ReadingUnit = Literal["counts", "rad/s", "deg/s"]
OutsideRange = Literal["error", "nan"]
READING_UNITS: tuple[ReadingUnit, ...] = ("counts", "rad/s", "deg/s")


class Calibration:
    """One board's calibration, ready to be applied.

    Rates are in rad/s, about the stage's axes (x tilt, y roll, z pan) or about the
    orthogonalised axes of the sensor; see docs/conventions.md.

    Args:
        source: the document.
        frame: axes of the rates, `stage` or `sensor`.
        bias_only: subtract the bias only and keep the nominal scale.
        digest: `sha256:` and the digest of the document's file.

    Raises:
        InputError: the verdict is refused, or a needed parameter is not known.
    """

    def __init__(
        self,
        source: CalibrationDocument,
        frame: Frame = "stage",
        *,
        bias_only: bool = False,
        digest: str = "",
    ) -> None:
        check_parameters(source, f"the calibration of {source.board.id}")
        self.document = source
        self.digest = digest
        self.correction: Correction = (
            build_bias_correction(source) if bias_only else build_correction(source, frame)
        )

    @classmethod
    def load(cls, path: str | Path, frame: Frame = "stage", *, bias_only: bool = False) -> Self:
        """Return the calibration in a file.

        Raises:
            InputError: the file cannot be read, is not a calibration, has the
                verdict refused, or a
                needed parameter is not known.
        """
        document, digest = read_calibration(Path(path))
        return cls(document, frame, bias_only=bias_only, digest=digest)

    @property
    def board(self) -> str:
        """The board's identifier."""
        return self.document.board.id

    @property
    def frame(self) -> Frame:
        """Axes of the rates."""
        return self.correction.frame

    @property
    def nominal_scale_rad_s(self) -> float | None:
        """Nominal scale factor per count; None if the recording did not specify it."""
        return self.document.board.config.gyro_scale_rad_s

    @property
    def time_offset_s(self) -> float | None:
        """Delay of the samples behind the motion; None if it was not observable."""
        value = self.document.parameters["time_offset"].value
        return value if isinstance(value, float) else None

    @property
    def not_applied(self) -> tuple[str, ...]:
        """Parameters of the document that do not apply to later readings, with reasons."""
        return self.correction.not_applied

    def rates(
        self,
        readings: npt.ArrayLike,
        unit: ReadingUnit = "counts",
        *,
        temperature_degc: npt.ArrayLike | None = None,
        specific_force_m_s2: npt.ArrayLike | None = None,
        out: Output | None = None,
        outside: OutsideRange = "error",
    ) -> Output:
        """Return the true rates of readings, in rad/s, shape (n, 3).

        Args:
            readings: shape (n, 3), or (3,) for one; in the sensor's axes.
            unit: of the readings: counts, or rad/s or deg/s at the nominal scale.
            temperature_degc: one value or one per reading; needed if a thermal cause was
                fitted.
            specific_force_m_s2: the accelerometer's readings in the sensor's axes, shape
                (n, 3); needed if g_sensitivity was fitted.
            out: the output array, shape (n, 3), float32 (twice as fast) or float64.
            outside: what to do at temperatures outside the valid range of the calibration: raise
                an error, or return nan for these readings.

        Raises:
            InputError: a temperature is outside the valid range.
            UsageError: the readings have another shape; the nominal scale of counts is not
                known; a temperature or force is missing.
        """
        values: Readings = np.asarray(readings)
        if values.shape[-1:] != (3,) or values.ndim > 2 or values.dtype.kind not in "iuf":
            raise UsageError(
                f"the readings have the type {values.dtype} and the shape {values.shape}, "
                "which cannot be corrected",
                "give an array of numbers with the shape (n, 3)",
            )
        rows = values.reshape(-1, 3)
        temperature = None if temperature_degc is None else np.asarray(temperature_degc, np.float64)
        force = None
        if specific_force_m_s2 is not None:
            force = np.asarray(specific_force_m_s2, np.float64).reshape(-1, 3)
        if temperature is not None and temperature.ndim and temperature.shape != rows.shape[:1]:
            raise UsageError(
                f"the numbers of temperatures ({temperature.size}) and of readings "
                f"({len(rows)}) differ",
                "give one temperature for all readings, or one temperature per reading",
            )
        degc = np.atleast_1d(np.nan if temperature is None else temperature)
        is_outside = np.isfinite(degc) & ~self.correction.covers(degc)
        if outside == "error" and is_outside.any():
            raise self.outside_range_error(degc[is_outside])
        rates = self.correction.rates(rows, self.scale_of(unit), temperature, force, out)
        if is_outside.any():
            rates[np.broadcast_to(is_outside, rates.shape[:1])] = np.nan
        return rates.reshape(values.shape)

    def outside_range_error(self, temperature_degc: FloatArray) -> InputError:
        """Return the error of temperatures outside the valid range."""
        low, high = self.correction.temperature_range_degc or (-np.inf, np.inf)
        coldest, warmest = np.nanmin(temperature_degc), np.nanmax(temperature_degc)
        return InputError(
            f"the calibration of {self.board} is valid from {low:.1f} to {high:.1f} degC, but the "
            f"board had {coldest:.1f} to {warmest:.1f} degC",
            "record the board at rest at these temperatures, and solve again",
        )

    def scale_of(self, unit: ReadingUnit) -> float:
        """Return the nominal scale factor of a reading's unit, in rad/s.

        Raises:
            UsageError: the document has no nominal scale of counts, or the unit is unknown.
        """
        if unit == "rad/s":
            return 1.0
        if unit == "deg/s":
            return float(np.pi / 180.0)
        if unit != "counts":
            raise UsageError(
                f"the unit {unit!r} of the readings is unknown",
                f"use one of the units {', '.join(READING_UNITS)}",
            )
        if self.nominal_scale_rad_s is None:
            raise UsageError(
                "the calibration does not contain the nominal scale factor, so it cannot "
                "correct readings in counts",
                "multiply the counts by the scale factor of the data sheet, and give the "
                "readings in rad/s",
            )
        return self.nominal_scale_rad_s

    def times(self, stamps_s: npt.ArrayLike) -> FloatArray:
        """Return the times of the motion from the times of the samples, in s.

        The times are unchanged if the time offset is not known.
        """
        return np.asarray(stamps_s, dtype=np.float64) - (self.time_offset_s or 0.0)
