"""Several causes of one covariate against one smooth function of it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.hidden.truth import make
from tests.support.board_fits import fit_base_model

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.discover import explain_fit

# A session of the scores: the bias follows the temperature through two lags, which is not in the
# catalogue. A ramp and a step of the bias together follow it as well as noise allows.
FIRST_SEED, SEED = 6_600_000, 6_600_002


@pytest.mark.long
def test_two_names_that_imitate_one_function_of_the_time_are_rejected(tmp_path: Path) -> None:
    make.main(
        ["--out", str(tmp_path), "--tier", "nearly", "--base", str(FIRST_SEED),
         "--first", str(SEED), "--count", "1"]
    )  # fmt: skip
    recording = read_recording(tmp_path / str(SEED) / "recording.mcap")
    board = str(recording.board_ids[0])
    findings = explain_fit(fit_base_model([recording], board), board).findings
    assert findings.causes == ()
    assert findings.unexplained is not None
    assert findings.unexplained.leading.covariate == "bias_time"


@pytest.mark.long
def test_two_true_causes_that_change_the_bias_over_time_keep_their_names(
    hidden: Callable[..., Any],
) -> None:
    session = hidden("warm_up:0.01", "bias_step:0.004", program="survey-130")
    base = fit_base_model([session.recording], session.board)
    findings = explain_fit(base, session.board).findings
    assert {cause.cause for cause in findings.causes} == {"warm_up", "bias_step"}
    assert findings.unexplained is None
