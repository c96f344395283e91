"""A bias that follows the heat of the motors is no cause of the time."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from tests.bench.rigs.recording_file import BOARD
from tests.hidden.independent.draws import draw_session
from tests.hidden.independent.make import make_case
from tests.support.board_fits import explain_recordings

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.discover.checks.motor_heat import LAGS_S, lagged_running_share

STEP_S = 1e-3
# Overlapping moves of two axes, a rest, and a move that ends where the next one begins.
SPANS_S = np.array([[2.0, 5.0], [4.0, 7.5], [12.0, 13.0], [13.0, 16.0]])


def test_the_share_is_a_first_order_lag_behind_the_moves() -> None:
    """Compared with a filter on a fine grid."""
    time_s = np.arange(0.0, 30.0, STEP_S)
    running = np.any((time_s >= SPANS_S[:, :1]) & (time_s < SPANS_S[:, 1:]), axis=0)
    share = lagged_running_share(SPANS_S, LAGS_S, time_s)
    for lag_s, row in zip(LAGS_S, share, strict=True):
        gain = -np.expm1(-STEP_S / lag_s)
        expected = lfilter([0.0, gain], [1.0, gain - 1.0], running.astype(np.float64))
        assert row == pytest.approx(expected, abs=2.0 * STEP_S / lag_s)
    assert not share[:, time_s < 2.0].any()
    assert not lagged_running_share(np.zeros((0, 2)), LAGS_S, time_s).any()


@pytest.mark.long
@pytest.mark.parametrize("seed", [13003, 13046, 13050])
def test_heat_of_the_motors_gets_no_name(seed: int, tmp_path: Path) -> None:
    """The second simulator has this effect; earlier it was a warm-up, a step and a walk."""
    session = draw_session(seed, "outside")
    assert session.effect is not None
    assert session.effect.entry.name == "motor_heat"
    make_case(tmp_path, session)
    recording = read_recording(tmp_path / "recording.mcap")
    findings = explain_recordings([recording], BOARD).findings
    assert not findings.causes
    assert findings.unexplained is not None
    tests = (findings.unexplained.leading, *findings.unexplained.others)
    assert "motor_heat" in {test.covariate for test in tests}
