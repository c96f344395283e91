"""The gyro feels gravity: rate per specific force.

y += K f, f = (0, g sin t, g cos t) on a level rig at tilt t, as the contract has it; K is
given against the stage's axes (against the sensor's own it is K M^T). Typical 0.1 dps/g
(MPU-6050 data sheet; other parts less), so 1.8e-4 rad/s per m/s^2; 1 dps/g is a bad part.
No axis of a pan-tilt unit brings gravity onto the stage's x axis: K's x column cannot be
seen on it. At one tilt K is part of the bias.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm
from gyrorig_solver.model.terms.protocol import Part, TermParameter
from gyrorig_solver.model.terms.scene import STANDARD_GRAVITY_M_S2, Scene, by_axis
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed

_DPS_PER_G = DEG / STANDARD_GRAVITY_M_S2
_LEAST_TILT_RAD = 0.05  # between poses; less moves gravity by less than 5 %


class GSensitivity(LinearTerm):
    """K, row by row: sensor axis, then stage axis of the force."""

    cause = "g_sensitivity"
    part: Part = "sensor"
    parameters = (
        TermParameter(
            name="sensitivity",
            unit="rad/s/(m/s^2)",
            typical=0.1 * _DPS_PER_G,
            lower=-2.0 * _DPS_PER_G,
            upper=2.0 * _DPS_PER_G,
            prior_std=1.0 * _DPS_PER_G,
            parts=tuple(row + column for row in XYZ for column in XYZ),
        ),
    )
    confused_with = ("earth_rotation", "vibration_rectification", "thermal_bias")
    excitation = "rests at four or more tilts, well apart"
    harm = "the bias is right at the tilts of the recording only"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return each component of the force on each axis, (9, blocks, 3)."""
        found = np.zeros((9, scene.blocks, 3))
        force = scene.seen(np.where(scene.known[:, None], scene.specific_force_m_s2, 0.0))
        for column in (1, 2):
            found[column::3] = by_axis(np.repeat(force[:, column : column + 1], 3, axis=1))
        return found

    def missing(self, scene: Scene) -> str | None:
        """Say that one tilt cannot tell it from a bias."""
        if not scene.has_angles:
            return "the reference has no pan and tilt; use a pan-tilt unit"
        tilt = scene.tilt_rad[scene.known]
        if tilt.size == 0 or float(np.ptp(tilt)) < _LEAST_TILT_RAD:
            return "the board rested at one tilt only; rest at four tilts, well apart"
        return None

    def sentence(self, values: FloatArray) -> str:
        """Say how much of gravity each axis reads as rate."""
        worst = np.abs(values.reshape(3, 3)).max(axis=1) / _DPS_PER_G
        return f"the gyro feels gravity: up to {listed(worst, XYZ, 'deg/s per g')}"


TERM = GSensitivity()
