"""What can be looked for beside a reference of attitudes: causes of the board, and one of its own.

What to use when: `terms_beside` for the causes that a space can be asked for.

An attitude that a camera gives is often a mean over time: frames last, markers are filtered,
attitudes are interpolated to the gyro's rate. A mean over a time of variance v makes of a body
rate w, to second order, w + v/2 (w'' + w x w'): R(t + s) averaged over s and made a rotation
again is R (1 + v/2 [w']x), and a rotation that is off by d = v/2 w' turns by w + d' + w x d
(derived here; the first is a low-pass, the second is what no low-pass of each axis can be).
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.discover.search import possible
from gyrorig_solver.estimate.attitude_space import MOVING_RAD_S, AttitudeScene, AttitudeSpace
from gyrorig_solver.model.terms.bases import LinearTerm
from gyrorig_solver.model.terms.catalogue import catalogue
from gyrorig_solver.model.terms.g_sensitivity import GSensitivity
from gyrorig_solver.model.terms.protocol import Part, Scope, Term, TermParameter
from gyrorig_solver.model.terms.scene import Scene, by_axis
from gyrorig_solver.model.terms.supply_hum import SupplyHum
from gyrorig_solver.model.terms.wording import DEG, XYZ, listed

LEAST_FORCE_M_S2 = 3.0  # of every component: a third of gravity
NAMELESS = ("moving_bias",)  # weighed beside the causes, never named
# Whose a cause may be just as well, where the reference is attitudes.
OR_THE_REFERENCE = {
    "clock_skew": "the reference's clock may be the one that is off",
    "clock_step": "the reference's clock may be the one that stepped",
    "board_slip": "the markers may be what slipped on the board",
}


class ReferenceSmoothing(LinearTerm):
    """The variance of the time over which the reference's attitudes are means."""

    cause = "reference_smoothing"
    part: Part = "environment"
    scope: Scope = "unit"  # the reference stands where a unit would
    parameters = (
        TermParameter(
            name="variance",
            unit="s^2",
            typical=2.5e-5,  # of 5 ms, half a frame of an ordinary camera
            lower=0.0,
            upper=2.5e-3,
            prior_std=1e-3,
        ),
    )
    confused_with = ("low_pass_lag", "clock_offset")
    excitation = "turns that change quickly, the axis with them"
    harm = "gains come out too large, the more so the quicker the turns"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return -1/2 G (w'' + w x w'), (1, blocks, 3)."""
        del values
        rate, block_s = scene.rate_rad_s, scene.step_s * scene.block
        across = np.cross(rate, np.gradient(rate, scene.step_s, axis=0))
        # Of block means: their differences hold less of what is faster than the band.
        slow = scene.read(rate)
        bend = np.gradient(np.gradient(slow, axis=0), axis=0) / block_s**2
        found = -0.5 * (bend + scene.read(across)) @ scene.gain.T
        return np.asarray(found[None], dtype=np.float64)

    def missing(self, scene: Scene) -> str | None:
        """Say that a unit's motion is nobody's mean."""
        return None if isinstance(scene, AttitudeScene) else "the reference is no attitude"

    def sentence(self, values: FloatArray) -> str:
        """Say over what time."""
        width_s = float(np.sqrt(max(float(values[0]), 0.0)))
        return f"the reference's attitudes are means over {width_s * 1e3:.3g} ms (rms)"


class MovingBias(LinearTerm):
    """A bias of the moving board for x, y, z, beside the resting one's: no cause, a signature.

    It is weighed like a cause so that no cause gets its name for standing in.
    """

    cause = "moving_bias"
    part: Part = "sensor"
    parameters = (
        TermParameter(
            name="bias",
            unit="rad/s",
            typical=0.1 * DEG,
            lower=-5.0 * DEG,
            upper=5.0 * DEG,
            prior_std=1.0 * DEG,
            parts=XYZ,
        ),
    )
    confused_with = ("scale_asymmetry", "scale_quadratic", "g_sensitivity", "dead_zone")
    excitation = "rests in several poses between motions of several speeds"
    harm = "the bias of the moving board is not that of the resting one"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return where the board moves on each axis, (3, blocks, 3)."""
        del values
        runs = np.linalg.norm(scene.rate_rad_s, axis=1) > MOVING_RAD_S
        return by_axis(scene.read(np.repeat(runs[:, None].astype(np.float64), 3, axis=1)))

    def sentence(self, values: FloatArray) -> str:
        """Say the shifts."""
        said = listed(values / DEG * 1e3, XYZ, "mdeg/s")
        return f"the bias of the moving board is not that of the resting one: {said}"


class ForceSensitivity(GSensitivity):
    """K against all three components of what the board's accelerometer reads."""

    excitation = "an accelerometer in the recording, and poses all around"

    def basis(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return each component of the force on each axis, (9, blocks, 3)."""
        del values
        found = np.zeros((9, scene.blocks, 3))
        force = scene.seen(scene.specific_force_m_s2)
        for column in range(3):
            found[column::3] = by_axis(np.repeat(force[:, column : column + 1], 3, axis=1))
        return found

    def missing(self, scene: Scene) -> str | None:
        """Say that there is no accelerometer, or that gravity stayed where it was."""
        if not isinstance(scene, AttitudeScene) or scene.force_m_s2 is None:
            return "the recording has no accelerometer; record one beside the gyro"
        if float(np.ptp(scene.force_m_s2, axis=0).min()) < LEAST_FORCE_M_S2:
            return "the board was never turned over; hold it in poses all around"
        return None


class HumInBand(SupplyHum):
    """Lines of the mains are faster than what a reference of attitudes can judge."""

    def missing(self, scene: Scene) -> str | None:
        """Say so."""
        del scene
        return "only slow rates are compared with the reference; record the board at rest"


def terms_beside(space: AttitudeSpace) -> tuple[list[Term], list[tuple[str, str]]]:
    """Return the causes that can be looked for, and the others with the reason."""
    own = {
        one.cause: one
        for one in (ReferenceSmoothing(), ForceSensitivity(), HumInBand(), MovingBias())
    }
    terms: list[Term] = []
    blind: list[tuple[str, str]] = []
    for cause, term in sorted({**catalogue(), **own}.items()):
        if term.kind == "effect" and cause != "lost_samples":  # seen as a step of the clock
            why = [r for r in (term.missing(scene) for scene in space.scenes) if r is not None]
            if why:
                blind.append((cause, why[0]))
            else:
                terms += possible(term, space)
        elif term.kind in ("gauge", "known"):
            blind.append((cause, _elsewhere(term, space)))
    return terms, blind


def _elsewhere(term: Term, space: AttitudeSpace) -> str:
    """Return why a cause that is no effect cannot be told."""
    missing = term.missing(space.scenes[0])
    return missing if missing is not None else term.excitation
