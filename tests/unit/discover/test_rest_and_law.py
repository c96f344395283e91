"""A recording at rest that is fitted together with a survey: causes of the motion law."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.discover import MotionFitSpace
from gyrorig_solver.discover.score_tests import scan_catalogue
from gyrorig_solver.estimate.motion_fit import solve_motion
from gyrorig_solver.model.catalogue import term_of_law
from gyrorig_solver.pipeline import board_data, load_board
from gyrorig_solver.pipeline.board_data import reference_motion
from gyrorig_solver.pipeline.recording_contexts import read_contexts
from gyrorig_solver.reference import ReferenceMotion, RestReference, TimeInterval


@pytest.mark.long
def test_the_effects_of_the_law_are_those_of_the_survey(hidden: Callable[..., Any]) -> None:
    """Before, a rest that was the first recording gave the base speed zero."""
    resting = hidden(program="static", seed=22)
    survey = hidden(program="survey-40", seed=22)
    assert resting.recording.start_ns < survey.recording.start_ns
    alone, together = (
        _detectable_base_speeds(MotionFitSpace(fit_base_model(chosen, survey.board)))
        for chosen in ([survey.recording], [resting.recording, survey.recording])
    )
    assert len(alone) == 3
    assert together == pytest.approx(alone, rel=0.02)


@pytest.mark.long
def test_a_rest_without_a_unit_does_not_hide_the_replies(
    pair: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before, the causes of the motion law were then tested by the samples alone."""
    _, resting = pair
    rest = RestReference((TimeInterval(-math.inf, math.inf),))

    def read_motion(recording: Recording, samples: GyroSamples) -> ReferenceMotion:
        is_resting = recording.path == resting.recording.path
        return rest if is_resting else reference_motion(recording, samples)

    monkeypatch.setattr(board_data, "reference_motion", read_motion)
    alone, together, rest_first = (
        _detectable_base_speeds(MotionFitSpace(solve_motion(recordings, (), contexts)))
        for recordings, contexts in _orders(pair)
    )
    assert together == pytest.approx(alone, rel=0.02)
    assert rest_first == pytest.approx(alone, rel=0.02)


def _orders(pair: tuple[Any, Any]) -> Iterator[tuple[list[Any], list[Any]]]:
    """Yield the samples with their motions, and the contexts, of the survey and of both orders."""
    data = load_board([session.recording for session in pair], pair[0].board)
    motions = [(samples, reference) for _, samples, reference in data.sessions]
    contexts = read_contexts(data.sessions)
    for order in ([0], [0, 1], [1, 0]):
        renumbered = [replace(contexts[k], recording_index=i) for i, k in enumerate(order)]
        yield [motions[k] for k in order], renumbered


def _detectable_base_speeds(space: MotionFitSpace) -> dict[str, float]:
    """Return the smallest change of the base speed that a score detects, at each place."""
    scores = scan_catalogue(space.projector(), [term_of_law("base_speed")], tests=100)
    return {str(score.place): score.detectable_size.detectable for score in scores}
