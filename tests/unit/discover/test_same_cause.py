"""A cause of one recording is judged with what other recordings of the board say."""

import numpy as np
import pytest

from gyrorig_solver.discover.cause_ranking import (
    SAME_CAUSE_BELIEF,
    RankedCause,
    _with_other_recordings,
)
from gyrorig_solver.discover.exact_fit import FittedCandidate
from gyrorig_solver.estimate import FittedTerm
from gyrorig_solver.model import limit_to_recording
from gyrorig_solver.model.catalogue import catalogue


def _candidate(cause: str, number: int | None) -> FittedCandidate:
    term = catalogue()[cause]
    term = term if number is None else limit_to_recording(term, number)
    extension = FittedTerm(term, np.zeros(4), np.arange(1))
    return FittedCandidate(extension, None, 20.0, 15.0, np.ones(1), np.zeros(1), infeasible=False)


def _ranked(number: int | None, shares: dict[str, float]) -> RankedCause:
    (first, share), *others = shares.items()
    rivals = tuple((_candidate(cause, number), each) for cause, each in others)
    return RankedCause(_candidate(first, number), 1.0, rivals, share)


def test_a_sure_name_in_one_recording_decides_the_other() -> None:
    open_set = _ranked(0, {"warm_up": 0.6, "bias_ramp": 0.4})
    sure = _ranked(1, {"bias_ramp": 0.999, "warm_up": 0.001})
    judged = _with_other_recordings(open_set, [open_set, sure])
    assert judged.posterior < 0.05
    ((rival, share),) = judged.rivals
    assert rival.extension.term.cause == "bias_ramp"
    assert share > 0.95
    assert judged.lead_nats(0) == pytest.approx(
        np.log((SAME_CAUSE_BELIEF * 0.999 + 0.025) / (SAME_CAUSE_BELIEF * 0.001 + 0.025))
    )
    assert _with_other_recordings(sure, [open_set, sure]).posterior > 0.99


def test_recordings_that_disagree_leave_each_other_alone() -> None:
    first = _ranked(0, {"warm_up": 0.999, "bias_ramp": 0.001})
    second = _ranked(1, {"bias_step": 1.0})
    assert _with_other_recordings(first, [first, second]) is first


def test_a_cause_of_all_recordings_is_not_judged_again() -> None:
    common = _ranked(None, {"thermal_bias": 0.6, "bias_ramp": 0.4})
    sure = _ranked(1, {"bias_ramp": 1.0})
    assert _with_other_recordings(common, [common, sure]) is common


def test_the_reason_names_the_other_recording() -> None:
    open_set = _ranked(0, {"bias_ramp": 0.5, "warm_up": 0.5})
    sure = _ranked(1, {"bias_ramp": 0.999, "warm_up": 0.001})
    (rival,) = _with_other_recordings(open_set, [open_set, sure]).describe_rivals()
    assert rival.posterior < 0.05
    assert "another recording" in rival.reason
