"""Names an error of the unit's ramps that its replies show."""

from dataclasses import replace

import numpy as np

from gyrorig_solver.discover.checks.model_check import JudgedModel, Verdict
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.ramp_acceleration import detect_ramp_error
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE
from gyrorig_solver.model import Stage, term_of_law
from gyrorig_solver.model.catalogue import catalogue

RAMP_STAGES: tuple[Stage, ...] = ("profile", "motor")


class RampCheck:
    """Names an error of the ramps, or states the size that would have been detected."""

    removes_names = False

    def judge(self, model: JudgedModel[MotionFitSpace]) -> Verdict:
        """Return the named error, or its detection limits.

        A base speed from the grid is a start value for a fit. The grid is coarse, so that the
        standard uncertainty from it is not valid.
        """
        result = detect_ramp_error(model.space.solution, model.tests, FALSE_ALARM_RATE)
        named = result.named
        acceleration = term_of_law("acceleration").cause  # always tested by `detect_ramp_error`
        if named is None:
            covered = frozenset({acceleration})
            return Verdict(detection_limits=result.detection_limits, covered_causes=covered)
        if named.cause != acceleration:
            values = tuple(replace(value, std=np.inf) for value in named.values)
            named = replace(named, values=values)
        states = model.result.projector.states
        if any(state.context.is_averaged and not state.is_at_rest for state in states):
            # The replies alone do not distinguish these causes, but exact rates would.
            ramp_causes = [term.cause for term in catalogue().values() if term.stage in RAMP_STAGES]
            others = tuple(cause for cause in ramp_causes if cause != named.cause)
            named = replace(named, one_of=others)
        return Verdict(named=(named,), covered_causes=frozenset({acceleration, named.cause}))
