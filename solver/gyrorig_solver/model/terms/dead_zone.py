"""Slow rates are not felt.

(G omega)_i counts as zero where its size is below d_i. A threshold of the sensing element,
or a firmware's dead band; 0.1 deg/s is much. One count (0.009 deg/s) is no dead zone: noise
carries the mean across it.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import CurvedTerm, scanned
from gyrorig_solver.model.terms.protocol import Part, TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed


class DeadZone(CurvedTerm):
    """Half width d for x, y, z."""

    cause = "dead_zone"
    part: Part = "sensor"
    parameters = (
        TermParameter(
            name="threshold",
            unit="rad/s",
            typical=0.1 * DEG,
            lower=0.0,
            upper=5.0 * DEG,
            prior_std=1.0 * DEG,
            parts=XYZ,
        ),
    )
    confused_with = ("scale_cubic", "motor_coupling")
    excitation = "moves slower than the suspected threshold, about every axis"
    derivative_step = 0.2  # the effect jumps as one interval after another falls in
    harm = "slow rotation is lost; scale and bias hardly move"

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return what is not felt, (blocks, 3)."""
        rate = scene.sensor_rate_rad_s
        return scene.seen(np.where(np.abs(rate) < values, -rate, 0.0))

    def bank(self, scene: Scene) -> FloatArray:
        """Look from several widths; there is no derivative at zero."""
        return scanned(self, threshold=DEG * np.geomspace(0.05, 4.0, 16))

    def sentence(self, values: FloatArray) -> str:
        """Say the thresholds."""
        return f"rates are not felt below {listed(values / DEG, XYZ, 'deg/s')}"


TERM = DeadZone()
