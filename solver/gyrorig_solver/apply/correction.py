"""The inverse sensor model: from readings of a board to true rates.

What to use when: `build_correction` (module `calibration_correction`) for a document;
`Correction.rates` for readings. The model is that of the document, with u = G omega, k and s the
changes of bias and scale with the temperature T (polynomials or splines), and f the specific force:

    y = u (1 + s(T) + q u + c u^2) + a |u| + b + k(T) + K f

It is solved for u. Then omega = G^-1 u in the stage's axes, or (S T)^-1 u in the
orthogonalised axes of the sensor.

Causes of the pan-tilt unit and of a single recording do not act on later readings. They are
left out and listed in `Correction.not_applied`.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.apply.affine import Output, Readings, transform_readings
from gyrorig_solver.data import BoolArray, FloatArray, TemperatureCurve

Frame = Literal["stage", "sensor"]
FRAMES: tuple[Frame, ...] = ("stage", "sensor")

_NEWTON_STEPS = 4  # the non-linearity is below a tenth: three steps reach the last digit
_BLOCK_SAMPLES = 65536  # readings per block where the arithmetic needs several copies


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
        """That of the bias curve, else of the scale curve; nan if rates do not depend on it."""
        return self._curves[0].reference_degc if self._curves else float("nan")

    @property
    def temperature_range_degc(self) -> tuple[float, float] | None:
        """The temperatures to which the correction can be applied; None: not limited."""
        ranges = [curve.range_degc for curve in self._curves if curve.range_degc is not None]
        if not ranges:
            return None
        return max(low for low, _ in ranges), min(high for _, high in ranges)

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

    def affine_form(self) -> tuple[FloatArray, FloatArray]:
        """Return the matrix (3, 3) and the offset (3,), rad/s, at the reference temperature."""
        degc = np.full(1, self.reference_degc)
        matrix, bias = self.inverse, self.bias_rad_s
        if self.bias_curve is not None and not self.bias_curve.is_zero:
            bias = bias + self.bias_curve.change(degc)[0]
        if self.scale_curve is not None and not self.scale_curve.is_zero:
            matrix = matrix / (1.0 + self.scale_curve.change(degc)[0])
        return matrix, np.asarray(-matrix @ bias, dtype=np.float64)

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
            matrix, offset = self.affine_form()
            return transform_readings(readings, scale_rad_s * matrix, offset, out)
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
