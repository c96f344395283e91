"""The tilt axis' zero is not where the stage is level.

True tilt t + z. The rate becomes Rx(z)^T omega, whatever the motion: exactly a turn of M
about x. So a gyroscope alone never shows it, and M is only as good as the zero: a home
sensor repeats to a position (0.05 deg) but stands 0.1 to 1 deg off level. The accelerometer
breaks it: see `leveling.tilt_zero_from_accelerometer`.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import CurvedTerm
from gyrorig_solver.model.terms.protocol import Kind, Link, Part, Scope, TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import DEG


class TiltZero(CurvedTerm):
    """One angle, z: true tilt minus told tilt."""

    cause = "tilt_zero"
    part: Part = "ptu"
    link: Link = "axes"
    kind: Kind = "gauge"
    scope: Scope = "unit"
    parameters = (
        TermParameter(
            name="angle",
            unit="rad",
            typical=0.3 * DEG,
            lower=-5.0 * DEG,
            upper=5.0 * DEG,
            prior_std=1.0 * DEG,
        ),
    )
    excitation = "the board's accelerometer at rest at several tilts; no motion shows it"
    harm = "the misalignment about x is off by the whole angle, and nothing shows in a residual"

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the exact change of rate, (blocks, 3)."""
        return self._turned(scene, float(np.sin(values[0])), float(np.cos(values[0])) - 1.0)

    def columns(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return its derivative, (1, blocks, 3)."""
        return self._turned(scene, float(np.cos(values[0])), -float(np.sin(values[0])))[None]

    def missing(self, scene: Scene) -> str | None:
        """Say that the gyroscope cannot show it."""
        return (
            "a tilt zero is a turn of the misalignment about x; "
            "rest at several tilts with the accelerometer recorded"
        )

    def sentence(self, values: FloatArray) -> str:
        """Say the angle."""
        return f"the tilt axis' zero is {values[0] / DEG:.3f} deg off level"

    def _turned(self, scene: Scene, sine: float, cosine: float) -> FloatArray:
        _, y, z = scene.rate_rad_s.T
        rate = np.column_stack([np.zeros_like(y), cosine * y + sine * z, -sine * y + cosine * z])
        return scene.seen_at_stage(rate)


TERM = TiltZero()
