"""Steps that the unit loses at two times are two causes, each with its size and its time."""

from pathlib import Path

import numpy as np
import pytest
from tests.bench.accuracy.profile import RAD_PER_STEP
from tests.bench.rigs.prior_sizes import AXES
from tests.bench.rigs.recording_file import BOARD, write_recording
from tests.bench.rigs.rig import SimulatedRig, draw_rig
from tests.support.board_fits import fit_base_model

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.discover import CauseFindings, explain_fit
from gyrorig_solver.estimate import ConvergedFit, FittedTerm, refit_with_terms
from gyrorig_solver.model import find_term, occurrence_after, term_label

# Samples at 200 Hz. Pan loses 16 half steps in a move, and tilt loses 8 at the start of its next
# move, 3.9 s later. The rig also has hum of the supply.
SEED = 23_000_011
TIME_ERROR_S = 4e-4


@pytest.fixture(scope="module")
def rig() -> SimulatedRig:
    return draw_rig(SEED)


@pytest.fixture(scope="module")
def base(rig: SimulatedRig, tmp_path_factory: pytest.TempPathFactory) -> ConvergedFit:
    path = Path(tmp_path_factory.mktemp("rig"), "rig.mcap")
    write_recording(rig, path)
    return fit_base_model([read_recording(path)], BOARD)


@pytest.fixture(scope="module")
def findings(base: ConvergedFit) -> CauseFindings:
    return explain_fit(base, BOARD).findings


def lost_rad(rig: SimulatedRig) -> list[float]:
    return [rig.causes.get("lost_steps", axis) * RAD_PER_STEP for axis in AXES]


def loss_times_s(rig: SimulatedRig) -> list[float]:
    """Return when pan and tilt lose steps: in their first motion after the drawn time."""
    begin_s, end_s = 0.4, rig.session.end_s - 0.4
    event_s = begin_s + rig.causes.get("lost_steps", "at") * (end_s - begin_s)
    times_s = []
    for counted in rig.tracks.counted:
        moving_s = rig.tracks.edges_s[np.flatnonzero(np.diff(counted))]
        times_s.append(float(moving_s[moving_s >= event_s][0]))
    return times_s


def test_a_loss_at_a_slightly_wrong_time_keeps_its_samples(
    base: ConvergedFit, rig: SimulatedRig
) -> None:
    """The error of the time leaves a residual of 20 standard deviations at three samples."""
    first = find_term("lost_steps")
    second = occurrence_after(first, {"lost_steps"})
    assert second is not None
    times_s = np.array(loss_times_s(rig)) - 0.4 - TIME_ERROR_S
    pan, tilt = lost_rad(rig)
    sizes = np.array([0, 1])
    fit = refit_with_terms(
        base,
        [
            FittedTerm(first, np.array([0.8 * pan, 0.0, times_s[0]]), sizes),
            FittedTerm(second, np.array([0.0, 0.8 * tilt, times_s[1]]), sizes),
        ],
    )
    assert fit.outliers == 0
    assert fit.fitted_terms[0].values[0] == pytest.approx(pan, rel=0.1)
    assert fit.fitted_terms[1].values[1] == pytest.approx(tilt, rel=0.1)


@pytest.mark.long
def test_two_losses_are_found_with_their_sizes_and_times(
    findings: CauseFindings, rig: SimulatedRig
) -> None:
    assert findings.verdict == "explained"
    assert sorted(cause.cause for cause in findings.causes) == [
        "lost_steps",
        "lost_steps",
        "supply_hum",
    ]
    losses = [cause for cause in findings.causes if cause.cause == "lost_steps"]
    by_axis = {cause.where: cause.extension.values for cause in losses}
    assert by_axis.keys() == {("pan",), ("tilt",)}
    pan, tilt = by_axis[("pan",)], by_axis[("tilt",)]
    assert [pan[0], tilt[1]] == pytest.approx(lost_rad(rig), rel=0.03)
    assert tilt[2] - pan[2] == pytest.approx(float(np.diff(loss_times_s(rig))[0]), abs=2e-3)


@pytest.mark.long
def test_each_loss_has_a_label(findings: CauseFindings) -> None:
    labels = {term_label(cause.term) for cause in findings.causes}
    assert labels == {"lost_steps", "lost_steps#2", "supply_hum"}
