"""Checks of a recording, and comparison of results with the truth of an emulated rig.

What to use when: `recording_health.examine_recording` for the content and the defects of a
recording and for the parameters that its motion makes observable;
`health_messages.health_verdict` and `health_messages.health_problems` for the same as text;
`true_values` and `injected_causes` to compare results with an emulated rig.
"""

from gyrorig_solver.check.health_messages import health_problems, health_verdict
from gyrorig_solver.check.injected_causes import score_causes
from gyrorig_solver.check.recording_health import RecordingHealth, examine_recording
from gyrorig_solver.check.true_values import (
    ParameterComparison,
    compare_calibrations,
    compare_with_truth,
)

__all__ = [
    "ParameterComparison",
    "RecordingHealth",
    "compare_calibrations",
    "compare_with_truth",
    "examine_recording",
    "health_problems",
    "health_verdict",
    "score_causes",
]
