"""The bias jumps once.

y_i += s_i from the event on: 10 to 50 mdeg/s; a knock, a supply that changes, a part that
trims itself anew (up to 0.4 rad/s in a flight log).
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm, event_times, scanned, since
from gyrorig_solver.model.terms.protocol import Link, Part, Scope, TermParameter
from gyrorig_solver.model.terms.scene import Scene, by_axis
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed

LOOKS = 60  # times over a recording from which a step is looked for


class BiasStep(LinearTerm):
    """s for x, y, z, then when."""

    cause = "bias_step"
    part: Part = "sensor"
    link: Link = "bias"
    scope: Scope = "recording"
    parameters = (
        TermParameter(
            name="step",
            unit="rad/s",
            typical=0.03 * DEG,
            lower=-25.0 * DEG,
            upper=25.0 * DEG,
            prior_std=2.0 * DEG,
            parts=XYZ,
        ),
        TermParameter(
            "time", "s", typical=1.0, lower=-np.inf, upper=np.inf, prior_std=np.inf, role="event"
        ),
    )
    confused_with = ("bias_ramp", "thermal_bias", "warm_up", "bias_random_walk")
    excitation = "rests before and after; a second recording, in which it does not come again"
    harm = "the bias is a mean of two"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the step on each axis, (3, blocks, 3)."""
        share = since(scene, float(values[3]))
        return by_axis(scene.seen(np.repeat(share[:, None], 3, axis=1)))

    def bank(self, scene: Scene) -> FloatArray:
        """Look from times all over the recording."""
        return scanned(self, time=event_times(scene, LOOKS))

    def sentence(self, values: FloatArray) -> str:
        """Say step and time."""
        said = listed(values[:3] / DEG * 1e3, XYZ, "mdeg/s")
        return f"the bias jumps at {values[3]:.1f} s: {said}"


TERM = BiasStep()
