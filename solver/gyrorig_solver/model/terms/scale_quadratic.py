"""The scale bends with the rate, the same way in both directions.

y_i += q_i (G omega)_i^2: even in the rate. No data sheet gives it apart from its total
non-linearity (0.1 to 0.2 % of full scale); 0.1 deg/s at 100 deg/s is a fifth of that at 250.
"""

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm
from gyrorig_solver.model.terms.protocol import Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene, by_axis
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed

_AT_RAD_S = 100.0 * DEG  # sizes are told at this rate
_PER_DPS = DEG / _AT_RAD_S**2


class ScaleQuadratic(LinearTerm):
    """q for x, y, z."""

    cause = "scale_quadratic"
    part: Part = "sensor"
    parameters = (
        TermParameter(
            name="coefficient",
            unit="s/rad",
            typical=0.1 * _PER_DPS,
            lower=-3.0 * _PER_DPS,
            upper=3.0 * _PER_DPS,
            prior_std=1.0 * _PER_DPS,
            parts=XYZ,
        ),
    )
    confused_with = (
        "vibration_rectification",
        "scale_asymmetry",
        "motor_coupling",
        "scale_cubic",
    )
    excitation = "both directions at four speeds or more, the fastest near full scale"
    harm = "scale and bias are right at the speeds of the recording only"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return each axis' rate squared, (3, blocks, 3)."""
        return by_axis(scene.seen(scene.sensor_rate_rad_s**2))

    def sentence(self, values: FloatArray) -> str:
        """Say the error at 100 deg/s."""
        return f"the scale bends evenly: {listed(values / _PER_DPS, XYZ, 'deg/s at 100 deg/s')}"


TERM = ScaleQuadratic()
