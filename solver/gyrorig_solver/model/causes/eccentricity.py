"""Eccentricity: the pan wheel has runout, which gives an error once per turn.

pan + Re(z (exp(-i pan) + w exp(-2 i pan))), z = c + i s: the gain depends on the pan angle. 0.02 to
0.1 deg (from memory). A wheel that is not centred on its axis is rarely round, and each of its two
bearings has runout as well. w is the relative size of the component at twice per turn, with its
phase relative to the first. On tilt, the same function cannot be separated from a sagging payload
(see `tilt_sag`).
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import (
    BinnedDependence,
    TermParameter,
    shape_parameter,
    size_parameter,
)
from gyrorig_solver.model.term_kinds import LinearAngleTerm
from gyrorig_solver.model.value_format import DEG


def _parameter(name: str) -> TermParameter:
    return size_parameter(name, "rad", ("pan",), typical=0.05, limit=1.0, prior_std=0.3, factor=DEG)


def _oval_parameter(name: str) -> TermParameter:
    return shape_parameter(name, "1", typical=0.25, lower=-1.0, upper=1.0, prior_std=0.5)


class Eccentricity(LinearAngleTerm):
    """c and s, then w: in phase with the first harmonic and a quarter period ahead."""

    cause = "eccentricity"
    title = "The gear wheel is eccentric"
    equation = (
        "pan = pan + Re(z (exp(-i pan) + w exp(-2 i pan))), z = cosine + i sine, w = oval + "
        "i oval_across"
    )
    stage = "wheel"
    parameters = (
        _parameter("cosine"),
        _parameter("sine"),
        _oval_parameter("oval"),
        _oval_parameter("oval_across"),
    )
    confused_with = ("worm_error", "step_resolution")
    remedy = (
        "have the seat of the gear checked and record moves over the full range, or let `gyrorig "
        "solve` fit this cause"
    )
    covariates = ("pan_angle",)
    picture = BinnedDependence("gain", "pan")
    excitation = (
        "pan moves over the full range, because a range of ±80 deg does not separate the two "
        "harmonics"
    )
    effect_if_ignored = "the scale factors are valid at the pan angles of the recording only"
    is_persistent = True

    def angle_shapes(self, state: SignalState, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return cosine and sine of the pan angle, each with its second harmonic."""
        along, across = float(values[2]), float(values[3])
        cosine, sine = state.angle_waves.cosine_and_sine(0, 2.0 * np.pi)
        # The double-angle formulas need fewer trigonometric functions of each angle.
        double_cosine, double_sine = 1.0 - 2.0 * sine**2, 2.0 * sine * cosine
        return [
            (0, cosine + along * double_cosine + across * double_sine),
            (0, sine + along * double_sine - across * double_cosine),
        ]

    def describe(self, values: FloatArray) -> str:
        size = float(np.hypot(values[0], values[1])) / DEG
        return f"the pan angle is wrong by ±{size:.3g} deg once per turn"


TERM = Eccentricity()
