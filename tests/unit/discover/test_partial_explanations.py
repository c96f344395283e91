"""A cause of one recording, and an unexplained effect in the same recording or in another one."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.cause_ranking import RankedCause
from gyrorig_solver.discover.checks.redundancy import find_partial_explanations
from gyrorig_solver.discover.checks.residual_dependence import most_significant
from gyrorig_solver.discover.exact_fit import FittedCandidate
from gyrorig_solver.estimate import free_term
from gyrorig_solver.model import find_term, limit_to_recording


def _unexplained(recording_index: int | None, statistic: float) -> DependenceTest:
    p_value = float(np.exp(-statistic))
    return DependenceTest(
        "bias_time", "on the time", statistic, 24, p_value, recording_index=recording_index
    )


def _model_with_step(recording_index: int) -> Any:
    extension = free_term(limit_to_recording(find_term("bias_step"), recording_index))
    candidate = FittedCandidate(extension, None, 100.0, 90.0, np.ones(3), np.zeros(13), False)
    ranked = RankedCause(candidate, 1.0, (), 1.0)
    return cast(Any, SimpleNamespace(result=SimpleNamespace(ranked_causes=(ranked,))))


@pytest.mark.parametrize(("recording_index", "is_partial"), [(0, True), (1, False), (None, True)])
def test_an_effect_in_another_recording_is_no_part_of_the_same_effect(
    recording_index: int | None, is_partial: bool
) -> None:
    rest = [_unexplained(recording_index, 1000.0)]
    assert find_partial_explanations(_model_with_step(0), rest) == [is_partial]


def test_the_larger_effect_of_another_recording_hides_no_test() -> None:
    """Before, the most significant recording was the only one that counted for a covariate."""
    tests = most_significant([_unexplained(0, 200.0), _unexplained(1, 900.0)])
    assert [test.recording_index for test in tests] == [1, 0]
    assert find_partial_explanations(_model_with_step(0), tests) == [True]
