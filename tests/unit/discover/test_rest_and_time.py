"""A recording at rest that is fitted together with a survey: functions of the time."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import explain_recordings, fit_base_model

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.discover import MotionFitSpace
from gyrorig_solver.discover.checks.basis_family import BasisFamily
from gyrorig_solver.discover.checks.jitter_estimate import estimate_jitter
from gyrorig_solver.discover.checks.residual_dependence import (
    smooth_function_evidence,
)
from gyrorig_solver.discover.checks.smooth_alternatives import smooth_families
from gyrorig_solver.discover.checks.specification_tests import best_function_nats
from gyrorig_solver.discover.lag_series import lag_templates, window_edges_s
from gyrorig_solver.estimate import NuisanceProjector
from gyrorig_solver.model import AxisBiases, SignalState, find_term, limit_to_recording
from gyrorig_solver.pipeline import board_data


@pytest.mark.long
def test_a_rest_does_not_hide_an_unknown_change_of_the_bias(
    pair: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before, one function of the time acted in both recordings, and a random walk was named."""
    survey, resting = pair
    recordings = [survey.recording, resting.recording]

    def load_with_bias(recording: Recording, board: str) -> GyroSamples:
        samples = load_samples(recording, board)
        if recording is not survey.recording:
            return samples
        bias_rad_s = 2e-3 * np.sin(2.0 * np.pi * samples.time_s[:, None] / 17.0)
        rate_rad_s = samples.rate_rad_s + bias_rad_s * np.array([1.0, -0.6, 0.4])
        quantum_rad_s = samples.quantum_rad_s
        return replace(samples, rate_rad_s=np.round(rate_rad_s / quantum_rad_s) * quantum_rad_s)

    monkeypatch.setattr(board_data, "load_samples", load_with_bias)
    alone = explain_recordings(recordings[:1], survey.board).findings
    together = explain_recordings(recordings, survey.board).findings
    assert alone.unexplained is not None
    assert alone.unexplained.leading.description == "on the time (the bias changes)"
    assert together.verdict == alone.verdict == "unexplained"
    assert together.unexplained is not None
    leading = together.unexplained.leading
    assert leading.description == "on the time of recording 1 (the bias changes)"


def test_each_recording_has_its_own_functions_of_the_time(pair: tuple[Any, Any]) -> None:
    survey, resting = pair
    recordings = [survey.recording, resting.recording]
    alone, together = (
        MotionFitSpace(fit_base_model(chosen, survey.board)).projector()
        for chosen in (recordings[:1], recordings)
    )
    (expected,) = _families_of_covariate(alone, "bias_time")
    families = _families_of_covariate(together, "bias_time")
    assert [family.recording_index for family in families] == [0, 1]
    assert len({family.description for family in families}) == 2
    for family in families:
        for state in together.states:
            is_limited = state.context.recording_index == family.recording_index
            assert _signal_rows(family, state).any() == is_limited
    assert _signal_rows(families[0], together.states[0]) == pytest.approx(
        _signal_rows(expected, alone.states[0])
    )
    evidences_nats = [
        smooth_function_evidence(family.statistics(together), family.detail) for family in families
    ]
    assert best_function_nats(together, "bias_time") == pytest.approx(sum(evidences_nats))


def _families_of_covariate(projector: NuisanceProjector, covariate: str) -> list[BasisFamily]:
    return [family for family in smooth_families(projector.states) if family.covariate == covariate]


def _signal_rows(family: BasisFamily, state: SignalState) -> FloatArray:
    (function,) = family.signals
    signals = function(state)
    assert isinstance(signals, AxisBiases)
    return signals.rows


def test_a_rest_does_not_change_the_jitter(
    pair: tuple[Any, Any], hidden: Callable[..., Any]
) -> None:
    """Before, the noise levels of the rest, which contain no jitter, reduced it by a tenth."""
    survey, (_, resting) = hidden("sample_jitter:1e-3", program="survey-40"), pair
    recordings = [survey.recording, resting.recording]
    alone, together = (
        estimate_jitter(NuisanceProjector.at_fit(fit_base_model(chosen, survey.board)), 60)
        for chosen in (recordings[:1], recordings)
    )
    assert alone is not None
    assert together is not None
    assert together.deviation_s == pytest.approx(alone.deviation_s, rel=1e-6)
    assert together.std_s == pytest.approx(alone.std_s, rel=1e-6)
    assert together.is_distinct


@pytest.mark.long
def test_a_rest_does_not_change_the_windows_of_the_lag(
    pair: tuple[Any, Any], hidden: Callable[..., Any]
) -> None:
    """Before, the windows also covered a longer rest, and their width grew with it."""
    survey, (_, resting) = hidden("clock_sawtooth:3e-4", program="survey-40"), pair
    recordings = [survey.recording, resting.recording]
    alone, together, at_rest = (
        MotionFitSpace(fit_base_model(chosen, survey.board)).projector()
        for chosen in (recordings[:1], recordings, recordings[1:])
    )
    edges_s = window_edges_s(alone.states)
    assert window_edges_s(together.states) == pytest.approx(edges_s)
    context = at_rest.states[0].context
    assert window_edges_s(at_rest.states)[[0, -1]].tolist() == [context.begin_s, context.end_s]
    assert context.end_s > 2.0 * edges_s[-1]
    sawtooth = find_term("clock_sawtooth")
    (index,) = {s.context.recording_index for s in together.states if not s.is_at_rest}
    expected, _ = lag_templates(alone, sawtooth)
    measured, _ = lag_templates(together, limit_to_recording(sawtooth, index))
    assert measured == pytest.approx(expected)
