"""A quantity of each axis as a function of the temperature: a polynomial or a cubic spline.

    f(T) - f(T0) = sum_p c_p (T - T0)^p + sum_j d_j (h_j(T) - h_j(T0)),  h_j(T) = max(T - k_j, 0)^3

T0 is the reference temperature, and the k_j are the knots of the spline; a polynomial has none. The
value f(T0) is not part of the curve. The module needs only NumPy, because code that applies a
calibration uses it.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.data.arrays import BoolArray, FloatArray

CUBIC = 3
CUBIC_FIT_POINTS = 201  # points at which a spline is compared with a cubic
RANGE_TOLERANCE_K = 0.5  # half a step of a coarse thermometer


@dataclass(frozen=True, slots=True, eq=False)
class TemperatureCurve:
    """The change of a quantity of three axes with the temperature."""

    reference_degc: float
    coefficients: FloatArray  # (orders, 3), c_p of each axis, quantity/K^p
    knots_degc: FloatArray  # (k,)
    knot_coefficients: FloatArray  # (k, 3), d_j of each axis, quantity/K^3
    range_degc: tuple[float, float] | None = None  # None: not known

    @classmethod
    def polynomial(
        cls,
        reference_degc: float,
        coefficients: FloatArray,
        range_degc: tuple[float, float] | None = None,
    ) -> Self:
        """Return a curve without knots; `coefficients`: shape (orders, 3), without a constant."""
        return cls(reference_degc, coefficients, np.zeros(0), np.zeros((0, 3)), range_degc)

    @property
    def is_zero(self) -> bool:
        """Whether the quantity does not depend on the temperature."""
        return not (self.coefficients.any() or self.knot_coefficients.any())

    def change(self, temperature_degc: FloatArray) -> FloatArray:
        """Return f(T) - f(T0), shape (n, 3), at temperatures (n,)."""
        degc = np.asarray(temperature_degc, dtype=np.float64)
        rise = degc - self.reference_degc
        total = np.zeros((degc.size, 3))
        for coefficient in self.coefficients[::-1]:
            total = (total + coefficient) * rise[:, None]
        for knot, coefficient in zip(self.knots_degc, self.knot_coefficients, strict=True):
            bend = np.maximum(degc - knot, 0.0) ** CUBIC
            total += (bend - max(self.reference_degc - knot, 0.0) ** CUBIC)[:, None] * coefficient
        return total

    def covers(self, temperature_degc: FloatArray) -> BoolArray:
        """Return which temperatures are in the valid range, within half a kelvin, shape (n,)."""
        degc = np.asarray(temperature_degc, dtype=np.float64)
        if self.range_degc is None:
            return np.isfinite(degc)
        low, high = self.range_degc
        return np.asarray(
            (degc >= low - RANGE_TOLERANCE_K) & (degc <= high + RANGE_TOLERANCE_K), dtype=np.bool_
        )

    def as_cubic(self) -> tuple[Self, FloatArray]:
        """Return the cubic polynomial that is nearest to the curve, with its largest error, (3,).

        A polynomial of the third order or less is returned as it is.

        Raises:
            ValueError: a spline has no valid range.
        """
        if not self.knots_degc.size and len(self.coefficients) <= CUBIC:
            return self, np.zeros(3)
        if self.range_degc is None:
            raise ValueError("a spline without a range")
        degc = np.linspace(*self.range_degc, CUBIC_FIT_POINTS)
        change = self.change(degc)
        scale = max(np.ptp(degc), 1e-9)
        # The weights of Chebyshev nodes keep the error at the ends of the range small.
        x = (2.0 * degc - self.range_degc[0] - self.range_degc[1]) / scale
        weight = 1.0 / np.sqrt(np.maximum(1.0 - x**2, 1e-3))
        rise = (degc - self.reference_degc) / scale
        design = rise[:, None] ** np.arange(1, CUBIC + 1)
        root = np.sqrt(weight)[:, None]
        fitted = np.linalg.lstsq(design * root, change * root, rcond=None)[0]
        error = np.abs(design @ fitted - change).max(axis=0)
        powers = scale ** -np.arange(1.0, CUBIC + 1.0)
        curve = self.polynomial(self.reference_degc, fitted * powers[:, None], self.range_degc)
        return curve, np.asarray(error, dtype=np.float64)
