"""The scale bends with the rate, oppositely in the two directions.

y_i += c_i (G omega)_i^3: odd in the rate. 0.2 % of a full scale of 250 deg/s at its end
(L3G4200D) is 0.03 deg/s at 100 deg/s.
"""

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm
from gyrorig_solver.model.terms.protocol import Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene, by_axis
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed

_AT_RAD_S = 100.0 * DEG  # sizes are told at this rate
_PER_DPS = DEG / _AT_RAD_S**3


class ScaleCubic(LinearTerm):
    """c for x, y, z."""

    cause = "scale_cubic"
    part: Part = "sensor"
    parameters = (
        TermParameter(
            name="coefficient",
            unit="s^2/rad^2",
            typical=0.03 * _PER_DPS,
            lower=-3.0 * _PER_DPS,
            upper=3.0 * _PER_DPS,
            prior_std=1.0 * _PER_DPS,
            parts=XYZ,
        ),
    )
    confused_with = ("scale_quadratic", "saturation", "scale_asymmetry")
    excitation = "four speeds or more, the fastest above 200 deg/s"
    harm = "the scale is right at the speeds of the recording only"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return each axis' rate cubed, (3, blocks, 3)."""
        return by_axis(scene.seen(scene.sensor_rate_rad_s**3))

    def sentence(self, values: FloatArray) -> str:
        """Say the error at 100 deg/s."""
        return f"the scale bends oddly: {listed(values / _PER_DPS, XYZ, 'deg/s at 100 deg/s')}"


TERM = ScaleCubic()
