"""What must follow from what: one session changed in a known way, and what is said of it.

No truth is needed here but that of the change itself. Sessions are recorded by another process.
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

FAR = 4.0  # standard deviations: one in 16 000
TURNED = {"x": "y", "y": "z", "z": "x"}
HIDDEN: Line = {"cause": "scale_quadratic", "place": "x", "seed": 301, "kind": "one"}
LINES: list[Line] = [
    {**HIDDEN, "name": "plus", "size": 0.004},
    {**HIDDEN, "name": "minus", "size": -0.004},
    {**HIDDEN, "name": "nothing", "size": 0.0},
    # The same rig on another day: its noise is new.
    {**HIDDEN, "name": "again", "size": 0.004, "seed": 302, "rig_seed": 301},
    {**HIDDEN, "name": "backwards", "size": 0.004, "program": "survey-40-backwards"},
]


@pytest.fixture(scope="module")
def recorded_sessions(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sessions]:
    made = Sessions(tmp_path_factory.mktemp("changed"), LINES)
    yield made
    made.close()


def findings(recorded_sessions: Sessions, k: int) -> CauseFindings:
    return recorded_sessions.stated(LINES[k]).explained.findings


def only(findings: CauseFindings) -> NamedCause:
    (cause,) = findings.causes
    assert cause.candidates == (HIDDEN["cause"],)
    return cause


def size(cause: NamedCause, axis: str) -> tuple[float, float]:
    """Return the fitted coefficient of an axis with its deviation."""
    value = next(v for v in cause.values if v.name == f"coefficient.{axis}")
    return value.value, value.std


def test_a_flipped_effect_flips_the_estimate(recorded_sessions: Sessions) -> None:
    plus, minus = (size(only(findings(recorded_sessions, k)), "x") for k in (0, 1))
    # Both are of the same noise: their sum is what it adds to each, less than two deviations.
    assert plus[0] > 0.0 > minus[0]
    assert plus[0] == pytest.approx(-minus[0], abs=FAR * np.hypot(plus[1], minus[1]))


def test_at_size_zero_nothing_is_found(recorded_sessions: Sessions) -> None:
    result = findings(recorded_sessions, 2)
    assert result.verdict == "adequate"
    assert result.causes == ()


def test_a_program_run_backwards_has_the_same_names(recorded_sessions: Sessions) -> None:
    forth, back = (only(findings(recorded_sessions, k)) for k in (0, 4))
    assert "x" in forth.where
    assert "x" in back.where
    others = [v for v in back.values if v.name != "coefficient.x"]
    assert all(abs(v.value) <= FAR * v.std for v in others)  # of another noise, and no more
    was, now = size(forth, "x"), size(back, "x")
    assert now[0] == pytest.approx(was[0], abs=FAR * np.hypot(was[1], now[1]))
    # As much is seen of it: no speed is another, only what comes when.
    slack = FAR * np.sqrt(2.0 * (2.0 * back.degrees_of_freedom + 4.0 * forth.statistic))
    assert back.statistic == pytest.approx(forth.statistic, abs=slack)


def test_a_board_mounted_otherwise_has_the_same_names(recorded_sessions: Sessions) -> None:
    def turned(samples: GyroSamples) -> GyroSamples:
        accel = samples.accel_m_s2
        return replace(
            samples,
            rate_rad_s=np.roll(samples.rate_rad_s, 1, axis=1),
            accel_m_s2=None if accel is None else np.roll(accel, 1, axis=1),
        )

    recording = read_recording(recorded_sessions.path("plus"))
    with patch.object(board_data, "load_samples", lambda *a: turned(load_samples(*a))):
        cause = only(explain_recordings([recording], recording.board_ids[0]).findings)
    before = only(findings(recorded_sessions, 0))
    assert {TURNED[axis] for axis in before.where} == set(cause.where)
    was, now = size(before, "x"), size(cause, "y")
    assert now[0] == pytest.approx(was[0], abs=0.1 * was[1])
    assert cause.statistic == pytest.approx(before.statistic, rel=0.02)


def test_the_evidence_of_two_runs_adds(recorded_sessions: Sessions) -> None:
    each = [only(findings(recorded_sessions, k)) for k in (0, 3)]
    recordings = [read_recording(recorded_sessions.path(name)) for name in ("plus", "again")]
    both = only(explain_recordings(recordings, recordings[0].board_ids[0]).findings)
    total = sum(cause.statistic for cause in each)
    # Chi-squared about its non-centrality: 2 (d + 2 lambda) is its variance. What both share
    # (the gain) is told better by two, so that less of the effect is taken by it.
    slack = FAR * np.sqrt(2.0 * (both.degrees_of_freedom + 2.0 * total))
    assert both.statistic == pytest.approx(total, abs=slack)
    assert both.statistic > 1.4 * max(cause.statistic for cause in each)
    value, std = size(both, "x")
    assert std < min(size(cause, "x")[1] for cause in each)
    assert value == pytest.approx(np.mean([size(cause, "x")[0] for cause in each]), abs=FAR * std)
