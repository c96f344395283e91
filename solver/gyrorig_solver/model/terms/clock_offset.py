"""The samples are late or early against the motion by one time.

y(t) = omega(t - tau): the base model's own time offset, filter delay and transport in one
(1 to 50 ms). To first order the effect is -tau d(G omega)/dt, which the fit takes whole.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm
from gyrorig_solver.model.terms.protocol import Kind, Link, Part, Scope, TermParameter
from gyrorig_solver.model.terms.scene import Scene


class ClockOffset(LinearTerm):
    """One time, how late the samples are."""

    cause = "clock_offset"
    part: Part = "clock"
    link: Link = "clock"
    kind: Kind = "gauge"
    scope: Scope = "recording"
    parameters = (TermParameter("offset", "s", typical=5e-3, lower=-0.5, upper=0.5, prior_std=0.1),)
    confused_with = ("low_pass_lag", "clock_step", "s_curve")
    excitation = "any fast start or stop; what it is made of needs pings and known filters"
    harm = "none: the time offset is a parameter of every calibration"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return minus the slope, (1, blocks, 3)."""
        return -scene.read(scene.filtered_slope_rad_s2)[None]

    def passed(self, scene: Scene, values: FloatArray) -> Scene:
        """Return the scene with its instants earlier."""
        return scene.with_delay(np.full(scene.use.size, -float(values[0])))

    def sentence(self, values: FloatArray) -> str:
        """Say the time."""
        return f"the samples are {values[0] * 1e3:.3g} ms late against the motion"


TERM = ClockOffset()
