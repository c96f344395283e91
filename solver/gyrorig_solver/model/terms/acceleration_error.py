"""The ramps are steeper or flatter than told.

acceleration (1 + e) from the same start to the same target: a timer's steps make the speeds
of a ramp (a part in a thousand), and a unit may not do the acceleration it accepts. Only
moves without orders on the way are laid anew. A reference that fits the ramps has it already.
"""

from dataclasses import replace

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import AngleTerm, scanned
from gyrorig_solver.model.terms.profiles import relaid
from gyrorig_solver.model.terms.protocol import Link, TermParameter
from gyrorig_solver.model.terms.scene import Scene
from gyrorig_solver.model.terms.wording import PAN_TILT, listed


class AccelerationError(AngleTerm):
    """e for pan and tilt."""

    cause = "acceleration_error"
    link: Link = "profile"
    parameters = (
        TermParameter(
            name="share",
            unit="1",
            typical=5e-3,
            lower=-0.5,
            upper=1.0,
            prior_std=0.1,
            parts=PAN_TILT,
        ),
    )
    confused_with = ("s_curve", "base_speed_jump", "clock_offset")
    excitation = "moves at several speeds, with ramps of different length"
    harm = "little: the time offset takes a part"

    def change(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return the moves as they were done minus as told, (2, n + 1)."""
        return redone(scene, (float(values[0]), float(values[1])), (0.0, 0.0))

    def passed(self, scene: Scene, values: FloatArray) -> Scene:
        """Return the scene with the moves laid anew."""
        return laid_anew(scene, (float(values[0]), float(values[1])), (0.0, 0.0))

    def bank(self, scene: Scene) -> FloatArray:
        """Look from small and large errors."""
        return scanned(self, share=np.array([-0.2, -0.05, 0.01, 0.05, 0.2]))

    def missing(self, scene: Scene) -> str | None:
        """Say that the moves' profiles are not known."""
        return no_profiles(scene)

    def sentence(self, values: FloatArray) -> str:
        """Say the shares."""
        return f"the ramps are steeper than told by {listed(values * 100.0, PAN_TILT, '%')}"


def redone(
    scene: Scene, acceleration_share: tuple[float, float], base_rad_s: tuple[float, float]
) -> FloatArray:
    """Return the change of the angles, (2, n + 1), by other limits of the axes.

    Beside what has changed them already: `scene.setting.laid`.
    """
    found = np.zeros_like(scene.angle_rad)
    resolution = scene.setting.rad_per_step
    if resolution is None:
        return found
    before = scene.setting.laid
    for axis, told in scene.setting.courses:
        size = resolution[axis]
        more = acceleration_share[axis], base_rad_s[axis] / abs(size)
        if more == (0.0, 0.0) or told.start_s[0] > scene.edges_s[-1]:
            continue
        share, base = before[axis][0], before[axis][1] / abs(size)
        done = relaid(told, more[0] + share, more[1] + base)
        had = told if before[axis] == (0.0, 0.0) else relaid(told, share, base)
        if done is None or had is None:
            continue
        end_s = max(had.end_s, done.end_s)
        first, last = np.searchsorted(scene.edges_s, [told.start_s[0], end_s])
        at = scene.edges_s[first:last]
        found[axis, first:last] += size * (done.position_steps(at) - had.position_steps(at))
    return found


def laid_anew(
    scene: Scene, acceleration_share: tuple[float, float], base_rad_s: tuple[float, float]
) -> Scene:
    """Return the scene with the moves laid by other limits of the axes."""
    made = scene.with_angles(redone(scene, acceleration_share, base_rad_s))
    laid = [
        (had[0] + share, had[1] + base)
        for had, share, base in zip(scene.setting.laid, acceleration_share, base_rad_s, strict=True)
    ]
    return replace(made, setting=replace(made.setting, laid=(laid[0], laid[1])))


def no_profiles(scene: Scene) -> str | None:
    """Return why profiles cannot be looked at, None where they can."""
    if not scene.has_angles:
        return "the reference has no pan and tilt; use a unit"
    if scene.setting.rad_per_step is None or not scene.setting.courses:
        return "what the unit was told is not known; record its commands"
    return None


TERM = AccelerationError()
