"""The next full step from the end of a fit: near zero if the fit is at its optimum.

What to use when: `next_step` for the fit whose values a command states; `is_at_optimum` for the
rule, which was set before the first run.
"""

from collections.abc import Mapping

from gyrorig_solver.estimate import ConvergedFit
from gyrorig_solver.estimate.board_fit import BoardFit
from gyrorig_solver.estimate.likelihood_fit import LikelihoodFit

MAX_STEP_SIGMA = 0.1  # of the next full step; errors of a tenth change no stated digit
MAX_DECREASE_NATS = 0.5  # of the objective by that step


def next_step(solution: ConvergedFit) -> dict[str, float]:
    """Return the next full step from the end of a fit, and what it changes in the objective."""
    problem = LikelihoodFit([BoardFit.resumed(solution, solution.fitted_terms, keep_rejected=True)])
    step = problem.propose(0.0)
    return {
        "step_sigma": step.size_sigma,
        "predicted_nats": step.predicted_decrease,
        "decrease_nats": problem.evaluate(step),
    }


def is_at_optimum(step: Mapping[str, float]) -> bool:
    """Return whether neither limit is exceeded; `step`: of `next_step`."""
    is_near = step.get("step_sigma", 0.0) <= MAX_STEP_SIGMA
    return is_near and abs(step.get("decrease_nats", 0.0)) <= MAX_DECREASE_NATS
