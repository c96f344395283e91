"""Clock faults that imitate another one together are replaced by it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_solver.discover.clock_fault_comparison import compare_clock_faults
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.estimate import FittedTerm
from gyrorig_solver.model import find_term, term_label

STEP_S = 0.01
PERIOD_S = 60.0  # longer than the recording: it shows one correction
CLOCK_FAULTS = ("clock_skew", "clock_step", "clock_sawtooth")
TESTS = 40


def labels_of(space: MotionFitSpace) -> list[str]:
    return [term_label(fitted_term.term) for fitted_term in space.fitted_terms]


@pytest.fixture(scope="module")
def stepped(hidden: Callable[..., Any]) -> Any:
    return hidden(f"clock_step:{STEP_S}", seed=33, program="survey-40")


@pytest.mark.long
def test_one_step_replaces_a_skew_and_a_sawtooth(stepped: Any) -> None:
    base = MotionFitSpace(fit_base_model([stepped.recording], stepped.board))
    terms = [find_term(name) for name in CLOCK_FAULTS]
    step = FittedTerm(terms[1], np.array([STEP_S, 0.0]), np.array([0]))
    event_s = scanned_event_s(base, step)
    rate = STEP_S / PERIOD_S
    pair = base.refit(
        [
            FittedTerm(terms[0], np.array([rate]), np.array([0])),
            FittedTerm(terms[2], np.array([-rate, PERIOD_S, event_s]), np.array([0])),
        ]
    )
    assert pair.convergence.converged
    assert base.log_likelihoods([pair])[0] > base.log_likelihoods([base])[0] + 100.0
    compared = compare_clock_faults(pair, terms, TESTS)
    assert labels_of(compared) == ["clock_step"]
    assert abs(compared.fitted_terms[0].values[0]) == pytest.approx(STEP_S, rel=0.05)


def test_a_single_fault_stays(stepped: Any) -> None:
    base = MotionFitSpace(fit_base_model([stepped.recording], stepped.board))
    skew = base.refit([FittedTerm(find_term("clock_skew"), np.array([1e-4]), np.array([0]))])
    assert compare_clock_faults(skew, [find_term("clock_step")], TESTS) is skew


def scanned_event_s(base: MotionFitSpace, step: FittedTerm) -> float:
    """Return the time at which a step of the clock explains most."""
    context = base.solution.sessions[0].context
    assert context is not None
    times_s = np.linspace(context.begin_s, context.end_s, 26)[3:-3]
    fits = [
        base.refit([FittedTerm(step.term, np.array([STEP_S, time_s]), np.array([0]))])
        for time_s in times_s
    ]
    return float(times_s[int(np.argmax(base.log_likelihoods(fits)))])
