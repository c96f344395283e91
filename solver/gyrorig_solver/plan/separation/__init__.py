"""The next experiment: a motion program that separates causes that a search could not separate.

What to use when: `propose_program` after a search, with the unit of `recorded_unit`. `cause_pairs`
has the expected log Bayes factor of two causes, `motion_blocks` has the motions of a program,
`simulated_recording` has the simulated recording of a program.
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
