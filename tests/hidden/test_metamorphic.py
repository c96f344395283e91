"""Metamorphic tests: a known change of a session must have a known effect on its explanation.

The tests need no truth except the change. Another process records the sessions.
"""

from collections.abc import Iterator
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from tests.hidden.fast import Line, Sessions
from tests.support.board_fits import explain_recordings

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.discover import CauseFindings, NamedCause
from gyrorig_solver.pipeline import board_data

pytestmark = pytest.mark.long

MAX_SIGMA = 4.0  # standard deviations; the probability of a larger error is 1 / 16 000
TURNED_AXES = {"x": "y", "y": "z", "z": "x"}
HIDDEN: Line = {"cause": "scale_quadratic", "place": "x", "seed": 301, "kind": "one"}
LINES: list[Line] = [
    {**HIDDEN, "name": "plus", "size": 0.004},
    {**HIDDEN, "name": "minus", "size": -0.004},
    {**HIDDEN, "name": "nothing", "size": 0.0},
    # the same rig with new noise
    {**HIDDEN, "name": "again", "size": 0.004, "seed": 302, "rig_seed": 301},
    {**HIDDEN, "name": "backwards", "size": 0.004, "program": "survey-40-backwards"},
]


@pytest.fixture(scope="module")
def recorded_sessions(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sessions]:
    sessions = Sessions(tmp_path_factory.mktemp("changed"), LINES)
    yield sessions
    sessions.close()


def get_findings(recorded_sessions: Sessions, k: int) -> CauseFindings:
    return recorded_sessions.explain(LINES[k]).explanation.findings


def get_only_cause(findings: CauseFindings) -> NamedCause:
    (cause,) = findings.causes
    assert cause.candidates == (HIDDEN["cause"],)
    return cause


def get_size(cause: NamedCause, axis: str) -> tuple[float, float]:
    """Return the fitted coefficient of an axis with its standard deviation."""
    value = next(v for v in cause.values if v.name == f"coefficient.{axis}")
    return value.value, value.std


def test_an_inverted_effect_inverts_the_estimate(recorded_sessions: Sessions) -> None:
    plus, minus = (
        get_size(get_only_cause(get_findings(recorded_sessions, k)), "x") for k in (0, 1)
    )
    # Both sessions have the same noise, so the sum of the sizes is twice the error from the noise.
    assert plus[0] > 0.0 > minus[0]
    assert plus[0] == pytest.approx(-minus[0], abs=MAX_SIGMA * np.hypot(plus[1], minus[1]))


def test_nothing_is_found_at_size_zero(recorded_sessions: Sessions) -> None:
    result = get_findings(recorded_sessions, 2)
    assert result.verdict == "adequate"
    assert result.causes == ()


def test_a_reversed_program_has_the_same_names(recorded_sessions: Sessions) -> None:
    forth, back = (get_only_cause(get_findings(recorded_sessions, k)) for k in (0, 4))
    assert "x" in forth.where
    assert "x" in back.where
    others = [v for v in back.values if v.name != "coefficient.x"]
    # The other axes have errors from noise only.
    assert all(abs(v.value) <= MAX_SIGMA * v.std for v in others)
    before_size, after_size = get_size(forth, "x"), get_size(back, "x")
    assert after_size[0] == pytest.approx(
        before_size[0], abs=MAX_SIGMA * np.hypot(before_size[1], after_size[1])
    )
    # The statistic is the same: the program has the same speeds in another order.
    slack = MAX_SIGMA * np.sqrt(2.0 * (2.0 * back.degrees_of_freedom + 4.0 * forth.statistic))
    assert back.statistic == pytest.approx(forth.statistic, abs=slack)


def test_a_board_with_exchanged_axes_has_the_same_names(recorded_sessions: Sessions) -> None:
    def turn_axes(samples: GyroSamples) -> GyroSamples:
        accel = samples.accel_m_s2
        return replace(
            samples,
            rate_rad_s=np.roll(samples.rate_rad_s, 1, axis=1),
            accel_m_s2=None if accel is None else np.roll(accel, 1, axis=1),
        )

    recording = read_recording(recorded_sessions.wait_for_path("plus"))
    with patch.object(board_data, "load_samples", lambda *a: turn_axes(load_samples(*a))):
        cause = get_only_cause(explain_recordings([recording], recording.board_ids[0]).findings)
    before = get_only_cause(get_findings(recorded_sessions, 0))
    assert {TURNED_AXES[axis] for axis in before.where} == set(cause.where)
    before_size, after_size = get_size(before, "x"), get_size(cause, "y")
    assert after_size[0] == pytest.approx(before_size[0], abs=0.1 * before_size[1])
    assert cause.statistic == pytest.approx(before.statistic, rel=0.02)


def test_the_statistics_of_two_runs_add_up(recorded_sessions: Sessions) -> None:
    each = [get_only_cause(get_findings(recorded_sessions, k)) for k in (0, 3)]
    recordings = [
        read_recording(recorded_sessions.wait_for_path(name)) for name in ("plus", "again")
    ]
    both = get_only_cause(explain_recordings(recordings, recordings[0].board_ids[0]).findings)
    total = sum(cause.statistic for cause in each)
    # The variance of a non-central chi-squared variable is 2 (d + 2 lambda). Two recordings
    # determine the common gain better, so the gain absorbs less of the effect.
    slack = MAX_SIGMA * np.sqrt(2.0 * (both.degrees_of_freedom + 2.0 * total))
    assert both.statistic == pytest.approx(total, abs=slack)
    assert both.statistic > 1.4 * max(cause.statistic for cause in each)
    value, std = get_size(both, "x")
    assert std < min(get_size(cause, "x")[1] for cause in each)
    assert value == pytest.approx(
        np.mean([get_size(cause, "x")[0] for cause in each]), abs=MAX_SIGMA * std
    )
