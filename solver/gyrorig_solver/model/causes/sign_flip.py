"""Sign flip: an axis counts backwards, because of a sign in a driver or a board upside down.

y_i' = -y_i. The gain and the bias absorb it completely. A mirrored gain (one axis, or three) has a
negative determinant, which no mount can produce.
"""

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.link_remedies import WRONG_AXES
from gyrorig_solver.model.signal_arrays import split_axes
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import size_parameter
from gyrorig_solver.model.term_kinds import LinearTerm
from gyrorig_solver.model.value_format import XYZ


class SignFlip(LinearTerm):
    """1 for a reversed axis, 0 for any other axis."""

    cause = "sign_flip"
    title = "An axis has the wrong sign"
    equation = "y_i = -y_i for the axes of `flipped`"
    part = "link"
    stage = "readout"
    kind = "gauge"
    parameters = (
        size_parameter("flipped", "1", XYZ, typical=1.0, lower=0.0, limit=1.0, prior_std=1.0),
    )
    confused_with = ("axis_swap",)
    remedy = "correct the sign of the axis in the driver or in the board's columns"
    file_remedy = WRONG_AXES.file
    covariates = None
    is_configuration_error = True
    picture = None
    excitation = "any motion, and a comparison of the gain's axes with the mount of the board"
    effect_if_ignored = (
        "none, because the calibration is valid for the axes in these directions; only the mount "
        "angles differ"
    )

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return minus twice each axis, (3, blocks, 3)."""
        return split_axes(-2.0 * (state.sample_output(state.filtered_rad_s) + state.bias_rad_s))

    def describe(self, values: FloatArray) -> str:
        flipped = [name for name, value in zip(XYZ, values, strict=True) if value > 0.5]
        return f"axes with the wrong sign: {', '.join(flipped) or 'none'}"


TERM = SignFlip()
