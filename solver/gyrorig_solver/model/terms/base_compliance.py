"""What the unit stands on gives way as the motors push.

angle - c angle'' on each axis: the reaction of an accelerated head twists its base, at once
(a mode far above the low-pass). 1e-4 s^2 is 0.01 deg at 100 deg/s^2. A pulse of rate at each
corner of a ramp, two opposite ones to a ramp. Short rounded corners (`s_curve`) are the same
but for the sign, which neither can change: only a positive c is a base.

Where a motor starts at its base speed the two opposite pulses come within no time, and the
first sample behind them has half of what they show. One that was taken as the speed jumped
saw neither, one or both: when it jumped is not known as well, so it is left out.
"""

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.model.terms.bases import LinearAngleTerm
from gyrorig_solver.model.terms.jumps import double_pulses, jumps, sharp_angle
from gyrorig_solver.model.terms.profiles import acceleration
from gyrorig_solver.model.terms.protocol import TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import PAN_TILT, listed

KNOWN_S = 3e-4  # a move's start: two or three deviations of what the fit knows of it


class BaseCompliance(LinearAngleTerm):
    """c for pan and tilt."""

    cause = "base_compliance"
    reshapes: bool = True
    parameters = (
        TermParameter(
            name="coefficient",
            unit="s^2",
            typical=1e-4,
            lower=0.0,
            upper=1e-2,
            prior_std=5e-3,
            parts=PAN_TILT,
        ),
    )
    confused_with = ("s_curve", "low_pass_lag", "ringing", "acceleration_error", "backlash")
    excitation = "the fastest accelerations of pan and of tilt; bolt the unit down"
    harm = "little: no angle stays off"

    def shapes(self, scene: Scene, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return minus the accelerations."""
        return [(k, -acceleration(scene.edges_s, scene.angle_rad[k])) for k in (0, 1)]

    def effect(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return what the twist does to the measured rate, (blocks, 3)."""
        return super().effect(scene, values) + self.unheld(scene, values)

    def unheld(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return what the jumps of the speed make sharper than the grid is, (blocks, 3)."""
        found = np.zeros((scene.blocks, 3))
        for axis, sharper in enumerate(self._sharper(scene)):
            if values[axis]:
                found += values[axis] * sharper
        return found

    def unsure(self, scene: Scene, values: FloatArray) -> BoolArray | None:
        """Return the samples that were taken as a speed jumped: they saw one pulse or none."""
        found = np.zeros(scene.use.size, dtype=np.bool_)
        for axis in np.flatnonzero(values):
            at_s, _ = jumps(scene, int(axis))
            first, last = np.searchsorted(scene.instants_s, [at_s - KNOWN_S, at_s + KNOWN_S])
            for k, stop in zip(first, last, strict=True):
                found[k:stop] = True
        each = np.asarray(found.reshape(scene.blocks, -1).any(axis=1), dtype=np.bool_)
        return each if found.any() else None

    def directions(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the derivative by the coefficients, (2, blocks, 3)."""
        return super().directions(scene, values) + np.stack(self._sharper(scene))

    def _sharper(self, scene: Scene) -> list[FloatArray]:
        """Return what the grid makes too blunt where the speed of each axis jumps."""
        found = []
        for axis in (0, 1):
            at_s, size = jumps(scene, axis)
            if scene.low_pass is None or not at_s.size:
                found.append(np.zeros((scene.blocks, 3)))
                continue
            blunt = acceleration(scene.edges_s, sharp_angle(scene.edges_s, at_s, size))
            held = scene.seen_at_stage(scene.turn_column(axis, -blunt))
            found.append(-double_pulses(scene, axis, at_s, size) - held)
        return found

    def sentence(self, values: FloatArray) -> str:
        """Say the give."""
        give = listed(np.degrees(values * np.radians(100.0)), PAN_TILT, "deg at 100 deg/s^2")
        return f"the base gives way as the head speeds up: {give}"


TERM = BaseCompliance()
