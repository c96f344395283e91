"""The next experiment: a motion program that separates causes between which a search could not.

What to use when: `propose_program` after a search, with the unit of `recorded_unit`.
`cause_pairs` has the expected log Bayes factor of two causes, `motion_blocks` the motions that a
program is made of, `simulated_recording` the recording of a program before it is made.
"""

from gyrorig_solver.plan.separation.cause_pairs import CausePair
from gyrorig_solver.plan.separation.motion_blocks import MotionBlock
from gyrorig_solver.plan.separation.next_program import (
    MAX_PROGRAM_S,
    NextExperiment,
    PairOutlook,
    propose_program,
)
from gyrorig_solver.plan.separation.simulated_recording import recorded_unit

__all__ = [
    "MAX_PROGRAM_S",
    "CausePair",
    "MotionBlock",
    "NextExperiment",
    "PairOutlook",
    "propose_program",
    "recorded_unit",
]
