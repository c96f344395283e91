"""Running motors shift the bias: by their current, through the supply or the field.

y_i += m_i while pan runs, n_i while tilt runs, whatever the speed. 20 mdeg/s; told from
vibration by not growing with speed.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm
from gyrorig_solver.model.terms.protocol import Link, Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene, by_axis
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed


def _parameter(name: str) -> TermParameter:
    return TermParameter(
        name=name,
        unit="rad/s",
        typical=0.02 * DEG,
        lower=-1.0 * DEG,
        upper=1.0 * DEG,
        prior_std=0.5 * DEG,
        parts=XYZ,
    )


class MotorCoupling(LinearTerm):
    """m, by pan, then n, by tilt, for x, y, z each."""

    cause = "motor_coupling"
    part: Part = "sensor"
    link: Link = "bias"
    parameters = (_parameter("pan"), _parameter("tilt"))
    confused_with = (
        "scale_asymmetry",
        "scale_quadratic",
        "vibration_rectification",
        "dead_zone",
    )
    excitation = "moves at several speeds with rests as long between them"
    harm = "the bias of the moving board is not that of the resting one"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return where each motor runs on each axis, (6, blocks, 3)."""
        runs = np.where(scene.known, scene.moving, False).astype(np.float64)
        seen = scene.seen(np.repeat(runs[:, :, None], 3, axis=2))
        return np.concatenate([by_axis(one) for one in seen])

    def missing(self, scene: Scene) -> str | None:
        """Say that the reference has no motors."""
        return None if scene.has_angles else "the reference has no pan and tilt; use a unit"

    def sentence(self, values: FloatArray) -> str:
        """Say the shifts."""
        pan, tilt = values[:3] / DEG * 1e3, values[3:] / DEG * 1e3
        return (
            f"running motors shift the bias: pan {listed(pan, XYZ, 'mdeg/s')}, "
            f"tilt {listed(tilt, XYZ, 'mdeg/s')}"
        )


TERM = MotorCoupling()
