"""Bases of the curve of a bias over temperature: polynomials and cubic splines."""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray, TemperatureCurve
from gyrorig_solver.data.temperature_curve import CUBIC

POLYNOMIAL_ORDERS = (1, 2, 3)
SPLINE_KNOTS = (1, 2, 3, 5)  # equally spaced inside the range
MIN_KNOT_DISTANCE_K = 4.0  # a finer structure is not a property of a sensor
MIN_POINTS_PER_COLUMN = 2  # points with different temperatures


@dataclass(frozen=True, slots=True, eq=False)
class CurveBasis:
    """Functions of the temperature, zero at the reference temperature."""

    order: int
    knots: FloatArray  # (k,), in units of the half range from the reference temperature
    reference_degc: float
    half_range_k: float

    @property
    def size(self) -> int:
        """The number of functions."""
        return self.order + self.knots.size

    @property
    def description(self) -> str:
        """The kind of curve, for people."""
        if self.knots.size:
            return f"cubic spline with {self.knots.size} knot{'s' * (self.knots.size > 1)}"
        return f"polynomial of order {self.order}"

    def columns(self, degc: FloatArray) -> FloatArray:
        """Return the functions at temperatures (n,), shape (n, size)."""
        x = (degc - self.reference_degc) / self.half_range_k
        powers = x[:, None] ** np.arange(1, self.order + 1)
        bends = np.maximum(x[:, None] - self.knots, 0.0) ** CUBIC
        bends -= np.maximum(-self.knots, 0.0) ** CUBIC
        return np.asarray(np.concatenate([powers, bends], axis=1), dtype=np.float64)

    def prior_std(self, amplitude: float) -> FloatArray:
        """Return the sizes' prior standard deviations, (size,), for an amplitude at the ends."""
        reach = np.maximum(np.abs(1.0 - self.knots), 0.1) ** CUBIC
        return np.asarray(amplitude / np.concatenate([np.ones(self.order), reach]), np.float64)

    def factors(self) -> FloatArray:
        """Return the factors that convert sizes to coefficients per K^p, shape (size,)."""
        powers = [*range(1, self.order + 1), *([CUBIC] * self.knots.size)]
        return np.asarray(self.half_range_k ** -np.array(powers, np.float64), np.float64)

    def curve(self, sizes: FloatArray, range_degc: tuple[float, float]) -> TemperatureCurve:
        """Return the curve of sizes (size, 3)."""
        coefficients = sizes * self.factors()[:, None]
        return TemperatureCurve(
            self.reference_degc,
            coefficients[: self.order],
            self.reference_degc + self.half_range_k * self.knots,
            coefficients[self.order :],
            range_degc,
        )


def candidate_bases(
    range_degc: tuple[float, float], reference_degc: float, distinct_points: int
) -> list[CurveBasis]:
    """Return the bases that a number of points at different temperatures can determine."""
    low, high = range_degc
    half = 0.5 * (high - low)
    bases = [CurveBasis(p, np.zeros(0), reference_degc, half) for p in POLYNOMIAL_ORDERS]
    for count in SPLINE_KNOTS:
        if (high - low) / (count + 1) < MIN_KNOT_DISTANCE_K:
            break
        knots_degc = np.linspace(low, high, count + 2)[1:-1]
        knots = np.asarray((knots_degc - reference_degc) / half, dtype=np.float64)
        bases.append(CurveBasis(CUBIC, knots, reference_degc, half))
    return [basis for basis in bases if distinct_points >= MIN_POINTS_PER_COLUMN + basis.size]
