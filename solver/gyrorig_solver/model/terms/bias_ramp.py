"""The bias drifts evenly.

y_i += r_i (t - mid), mid the middle of the recording: what is left of a slow warming where
no thermometer tells, or of ageing. A board that warms itself by 3 K over 300 s drifts by
0.1 deg/s at the L3G4200D's 0.03 dps/K, as much as a warm-up settles.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import LinearTerm
from gyrorig_solver.model.terms.protocol import Link, Part, Scope, TermParameter
from gyrorig_solver.model.terms.scene import Scene, by_axis
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed

_TYPICAL = 0.1 * DEG / 300.0


class BiasRamp(LinearTerm):
    """r for x, y, z."""

    cause = "bias_ramp"
    part: Part = "sensor"
    link: Link = "bias"
    scope: Scope = "recording"
    parameters = (
        TermParameter(
            name="slope",
            unit="rad/s^2",
            typical=_TYPICAL,
            lower=-100.0 * _TYPICAL,
            upper=100.0 * _TYPICAL,
            prior_std=50.0 * _TYPICAL,
            parts=XYZ,
        ),
    )
    confused_with = ("thermal_bias", "warm_up", "bias_random_walk", "bias_step")
    excitation = "a longer recording, and a thermometer"
    harm = "the bias is that of the recording's middle"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the time from the middle on each axis, (3, blocks, 3)."""
        middle = (scene.setting.begin_s + scene.setting.end_s) / 2.0
        return by_axis(scene.seen(np.repeat((scene.time_s - middle)[:, None], 3, axis=1)))

    def sentence(self, values: FloatArray) -> str:
        """Say the slopes."""
        return f"the bias drifts: {listed(values / DEG * 6e4, XYZ, 'mdeg/s a minute')}"


TERM = BiasRamp()
