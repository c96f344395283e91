"""The scale follows the temperature.

y_i += k_i (T - T0) (G omega)_i with T0 the recordings' mean. Data sheets: +-2 % over 125 K
(L3G4200D, MPU-6050), 0.016 %/K; 0.005 to 0.03 %/K of others.
"""

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm
from gyrorig_solver.model.terms.protocol import Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene, by_axis
from gyrorig_solver.model.terms.thermal_bias import at_die, no_temperature
from gyrorig_solver.model.terms.wording import XYZ, listed


class ThermalScale(LinearTerm):
    """k for x, y, z."""

    cause = "thermal_scale"
    part: Part = "sensor"
    parameters = (
        TermParameter(
            name="slope",
            unit="1/K",
            typical=1.6e-4,
            lower=-2e-3,
            upper=2e-3,
            prior_std=1e-3,
            parts=XYZ,
        ),
    )
    confused_with = ("board_slip", "thermal_bias", "clock_skew")
    excitation = "the same fast moves at temperatures 20 K apart"
    harm = "the scale is right at the temperature of the recording only"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return each axis' rate times the temperature, (3, blocks, 3)."""
        return by_axis(scene.seen(at_die(scene, 0.0)[:, None] * scene.sensor_rate_rad_s))

    def missing(self, scene: Scene) -> str | None:
        """Say that there is no temperature, or that it stayed the same."""
        return no_temperature(scene)

    def sentence(self, values: FloatArray) -> str:
        """Say the slopes."""
        return f"the scale follows the temperature: {listed(values * 100.0, XYZ, '% per kelvin')}"


TERM = ThermalScale()
