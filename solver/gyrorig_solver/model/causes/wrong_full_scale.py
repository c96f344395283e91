"""Wrong full scale: the sensor's range differs from the range that the driver assumes.

y' = 2^v y for all axes, v a whole number on most parts (250, 500, 1000, 2000 deg/s; an L3G4200D has
250, 500, 2000). The scale factor absorbs it completely. The distance of the scale factor from 1
identifies it, because data sheets limit this distance to 2 to 15 %.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.link_remedies import WRONG_FULL_SCALE
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import TermParameter
from gyrorig_solver.model.term_kinds import NonlinearTerm, scan_grid


class WrongFullScale(NonlinearTerm):
    """The exponent of two."""

    cause = "wrong_full_scale"
    title = "The full scale differs from the configuration"
    equation = "y = 2^doublings y"
    part = "link"
    stage = "readout"
    kind = "gauge"
    parameters = (
        TermParameter("doublings", "1", typical_size=1.0, lower=-4.0, upper=4.0, prior_std=2.0),
    )
    confused_with = ("clock_skew",)
    remedy = "read the range register of the sensor and set the board's full scale to that value"
    file_remedy = WRONG_FULL_SCALE.file
    covariates = None
    is_configuration_error = True
    picture = None
    excitation = "any motion, and a comparison of the scale factor with the data sheet's tolerance"
    effect_if_ignored = (
        "none, because the calibration is valid; only the configured full scale is wrong"
    )

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the change of the measured rate, (blocks, 3)."""
        factor = float(np.expm1(np.log(2.0) * values[0]))
        return factor * (state.sample_output(state.filtered_rad_s) + state.bias_rad_s)

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan ranges a factor of two and four apart."""
        return scan_grid(self, doublings=np.array([-2.0, -1.0, 1.0, 2.0]))

    def describe(self, values: FloatArray) -> str:
        return (
            f"the counts are {2.0 ** values[0]:.3g} times those that the configured full scale "
            "implies"
        )


TERM = WrongFullScale()
