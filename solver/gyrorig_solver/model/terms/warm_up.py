"""The bias settles after the power came on.

y_i += a_i exp(-(t - t_begin)/tau), t_begin the recording's begin, so that a is what is left
of it there. 0.05 to 0.3 deg/s over 30 to 120 s (as remembered); boards settle over minutes.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm, scanned
from gyrorig_solver.model.terms.protocol import Link, Part, Scope, TermParameter
from gyrorig_solver.model.terms.scene import Scene, by_axis
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed


class WarmUp(LinearTerm):
    """a for x, y, z, then the time constant."""

    cause = "warm_up"
    part: Part = "sensor"
    link: Link = "bias"
    scope: Scope = "recording"
    parameters = (
        TermParameter(
            name="begin",
            unit="rad/s",
            typical=0.1 * DEG,
            lower=-5.0 * DEG,
            upper=5.0 * DEG,
            prior_std=1.0 * DEG,
            parts=XYZ,
        ),
        TermParameter(
            name="time_constant",
            unit="s",
            typical=60.0,
            lower=5.0,
            upper=1200.0,
            prior_std=300.0,
            role="shape",
            start=60.0,
        ),
    )
    confused_with = ("thermal_bias", "bias_ramp", "bias_step", "bias_random_walk")
    excitation = "one recording from power-on and one an hour later"
    harm = "the bias is that of a board still warming up"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the decay on each axis, (3, blocks, 3)."""
        left = np.exp(-(scene.time_s - scene.setting.begin_s) / float(values[3]))
        return by_axis(scene.seen(np.repeat(left[:, None], 3, axis=1)))

    def bank(self, scene: Scene) -> FloatArray:
        """Scan the time constant."""
        return scanned(self, time_constant=np.array([8.0, 15.0, 30.0, 60.0, 120.0, 240.0, 600.0]))

    def sentence(self, values: FloatArray) -> str:
        """Say size and time."""
        said = listed(values[:3] / DEG, XYZ, "deg/s")
        return f"the bias settles within {values[3]:.0f} s of the begin, from {said}"


TERM = WarmUp()
