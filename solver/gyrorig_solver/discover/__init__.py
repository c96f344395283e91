"""Search for the causes of a base fit's residual.

What to use when: `fit_explanation.explain_fit` for one board, `boards.joint_explanation` for
several boards on one unit, `attitude.explain_attitudes` with reference attitudes. `cause_search`
is the search; `fit_space` contains the differences between references. `checks` contains the
checks of the result, and `cause_findings` the result types.
"""

from gyrorig_solver.discover.attitude.attitude_space import AttitudeFitSpace
from gyrorig_solver.discover.boards.joint_explanation import explain_jointly
from gyrorig_solver.discover.calibration_changes import CALIBRATION_PARAMETERS, CalibrationValues
from gyrorig_solver.discover.cause_findings import (
    CauseFindings,
    FitExplanation,
    HeldOutGain,
    NamedCause,
)
from gyrorig_solver.discover.fit_criticism import FitCriticism, criticise_fit
from gyrorig_solver.discover.fit_explanation import explain_fit
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE

__all__ = [
    "CALIBRATION_PARAMETERS",
    "FALSE_ALARM_RATE",
    "AttitudeFitSpace",
    "CalibrationValues",
    "CauseFindings",
    "FitCriticism",
    "FitExplanation",
    "HeldOutGain",
    "MotionFitSpace",
    "NamedCause",
    "criticise_fit",
    "explain_fit",
    "explain_jointly",
]
