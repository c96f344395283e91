"""Step size error: a step of the unit is not the angle that its resolution states.

angle (1 + e) on each axis, from the zero of the count: a gear ratio, a step mode or a rounded
resolution (185.1428 as 185 arcsec is 7.7e-4). On pan, the gain's y and z columns absorb it
completely, so nothing shows it. On tilt, the direction of the pan axis in the stage frame shows it
as a function of tilt.
"""

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.cause_categories import ANGLE_COVARIATES
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, size_parameter
from gyrorig_solver.model.term_kinds import LinearAngleTerm
from gyrorig_solver.model.value_format import PAN_TILT, format_list


class StepResolution(LinearAngleTerm):
    """The relative error e of pan and tilt."""

    cause = "step_resolution"
    title = "The step size differs from the configuration"
    equation = "angle = (1 + share) x stated angle"
    stage = "drive"
    parameters = (size_parameter("share", "1", PAN_TILT, typical=1e-3, limit=0.1, prior_std=0.02),)
    confused_with = ("tilt_sag", "clock_skew", "eccentricity")
    remedy = "query the resolution of the unit (commands PR and TR) and configure that value"
    covariates = ANGLE_COVARIATES
    picture = BinnedDependence("gain", "tilt", 10)
    confounded_with_gain = True
    unseen_places = ("pan",)
    excitation = (
        "pan sweeps at three or more tilts that are far apart, and a known turn for the step size "
        "of pan"
    )
    effect_if_ignored = (
        "the scale factors of y and z are wrong by the error of pan's step size, and no residual "
        "shows this error"
    )
    is_persistent = True

    def angle_shapes(self, state: SignalState, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return the angles themselves."""
        return [(0, state.angle_rad[0]), (1, state.angle_rad[1])]

    def describe(self, values: FloatArray) -> str:
        text = format_list(values * 100.0, PAN_TILT, "%")
        return f"the step size differs from the configured one by {text}"


TERM = StepResolution()
