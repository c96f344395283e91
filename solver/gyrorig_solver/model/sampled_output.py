"""The output of a sensor at its sampling instants, as a function of an additional delay.

What to use when: `SampledOutput.at_delay` for the output at delayed instants, `slope_at_delay` for
its time derivative. The output is constant beyond the ends of the grid.
"""

from dataclasses import dataclass
from functools import cached_property

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.hermite_interpolation import HermiteInterpolator


@dataclass(frozen=True, eq=False)
class SampledOutput:
    """An output on a grid, and the instants at which it is sampled."""

    grid_s: FloatArray  # (n,)
    output_rad_s: FloatArray  # (n, 3)
    slope_rad_s2: FloatArray  # its time derivative, (n, 3)
    instants_s: FloatArray  # (instants,), without an additional delay

    @cached_property
    def undelayed(self) -> FloatArray:
        """The output at the instants, (instants, 3)."""
        return self._interpolator(0.0).interpolate(self.output_rad_s, self.slope_rad_s2)

    @cached_property
    def undelayed_slope(self) -> FloatArray:
        """Its time derivative, (instants, 3)."""
        return self._interpolator(0.0).differentiate(self.output_rad_s, self.slope_rad_s2)

    def at_delay(self, delay_s: FloatArray) -> FloatArray:
        """Return the output at delayed instants, (instants, 3), by cubic Hermite interpolation."""
        if not delay_s.any():
            return self.undelayed
        return self._interpolator(delay_s).interpolate(self.output_rad_s, self.slope_rad_s2)

    def slope_at_delay(self, delay_s: FloatArray) -> FloatArray:
        """Return the time derivative of the output at delayed instants, (instants, 3)."""
        if not delay_s.any():
            return self.undelayed_slope
        return self._interpolator(delay_s).differentiate(self.output_rad_s, self.slope_rad_s2)

    def _interpolator(self, delay_s: FloatArray | float) -> HermiteInterpolator:
        return HermiteInterpolator.of(self.grid_s, self.instants_s + delay_s)
