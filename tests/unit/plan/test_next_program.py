"""The next experiment: a program that separates causes between which a search could not."""

from dataclasses import replace
from functools import cached_property
from pathlib import Path

import pytest
from tests.hidden.truth.session import RecordedSession, RigDraw, record
from tests.support.board_fits import explain_recordings
from tests.support.reference_recordings import SimulatedGyro, record_turns

from gyrorig_daemon.emulator.emulator_settings import InjectionRequest
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.program import parse_program
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.cli import run
from gyrorig_solver.discover import FitExplanation
from gyrorig_solver.discover.cause_ranking import nats_for_sole_name
from gyrorig_solver.findings.findings_document import parse_findings
from gyrorig_solver.pipeline import explain_boards
from gyrorig_solver.pipeline.board_results import BoardExplanation
from gyrorig_solver.pipeline.next_experiment import next_experiment, with_next_experiment
from gyrorig_solver.plan import NextExperiment, load_rig, program_text
from gyrorig_solver.plan.program_timeline import simulate_program
from gyrorig_solver.plan.rig_model import RigLimits
from gyrorig_solver.plan.separation import recorded_unit
from gyrorig_solver.plan.separation.next_program import _needed_nats

pytestmark = pytest.mark.long

RIG = Path(__file__).parents[3] / "config" / "rig.yaml"
HIDDEN = InjectionRequest("scale_quadratic", "z", 4e-4)
SECOND_SEED = 500_001
SHORT_S = 40.0


class AmbiguousRig:
    """A rig whose survey-40 recording states a set of causes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.session: RecordedSession = record(
            RigDraw(1, "survey-40", hide=(HIDDEN,)), folder / "first.mcap"
        )
        self.recording: Recording = read_recording(folder / "first.mcap")
        self.board = str(self.recording.board_ids[0])
        self.explanation: FitExplanation = explain_recordings([self.recording], self.board)

    def propose(self, max_duration_s: float = 120.0) -> NextExperiment:
        """Return the proposed program."""
        proposed = next_experiment([self.recording], self.explanation, None, max_duration_s)
        assert proposed is not None
        return proposed

    @cached_property
    def proposed(self) -> NextExperiment:
        """The program of the usual duration."""
        return self.propose()

    def record_second(self, proposed: NextExperiment) -> Recording:
        """Record the proposed program on the same rig, with other noise."""
        assert proposed.program is not None
        program = self.folder / "next-program.yaml"
        program.write_text(program_text(proposed.program), encoding="utf-8")
        path = self.folder / "second.mcap"
        record(RigDraw(SECOND_SEED, str(program), hide=(HIDDEN,)), path, self.session.rig.truth)
        return read_recording(path)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> AmbiguousRig:
    return AmbiguousRig(tmp_path_factory.mktemp("ambiguous"))


@pytest.mark.long
def test_a_program_makes_a_set_one_name(rig: AmbiguousRig) -> None:
    (before,) = rig.explanation.findings.causes
    assert set(before.candidates) == {"scale_quadratic", "scale_asymmetry"}
    proposed = rig.proposed
    (outlook,) = proposed.outlooks
    assert set(outlook.causes) == set(before.candidates)
    assert outlook.nats > nats_for_sole_name(0.0)
    assert outlook.is_separated
    both = [rig.recording, rig.record_second(proposed)]
    (after,) = explain_recordings(both, rig.board).findings.causes
    assert after.candidates == ("scale_quadratic",)


def test_a_program_stays_within_time_and_limits(rig: AmbiguousRig) -> None:
    proposed = rig.proposed
    assert proposed.program is not None
    assert proposed.duration_s <= proposed.max_duration_s
    unit = recorded_unit(rig.recording.metadata["gyrorig.ptu"])
    assert unit is not None
    read_back = parse_program(program_text(proposed.program), "next-program.yaml")
    # A step beyond an angle or a speed of the unit is refused.
    assert simulate_program(read_back, unit).duration_s == pytest.approx(proposed.duration_s)


def test_more_time_promises_more(rig: AmbiguousRig) -> None:
    short, full = rig.propose(SHORT_S), rig.proposed
    assert short.duration_s <= SHORT_S
    assert short.outlooks[0].nats < full.outlooks[0].nats
    assert short.outlooks[0].probability < full.outlooks[0].probability


def test_no_program_without_a_set(rig: AmbiguousRig) -> None:
    findings = rig.explanation.findings
    sole = replace(findings, causes=tuple(replace(cause, one_of=()) for cause in findings.causes))
    explanation = replace(rig.explanation, findings=sole)
    assert next_experiment([rig.recording], explanation) is None


@pytest.mark.parametrize(
    "change",
    [
        {"dialect": "unknown"},
        {"pan_max_steps": "-4000"},
        {"pan_max_steps": "9" * 40},
        {"tilt_resolution_arcsec": "nan"},
        {"pan_acceleration": "0"},
        {"pan_base_speed": "inf"},
        {"tilt_upper_speed": "1"},
        {"baud": "0"},
    ],
)
def test_no_program_for_a_unit_that_the_recording_does_not_describe(
    rig: AmbiguousRig, change: dict[str, str]
) -> None:
    metadata = {**rig.recording.metadata["gyrorig.ptu"], **change}
    assert recorded_unit(metadata) is None
    recording = replace(rig.recording, metadata={"gyrorig.ptu": metadata})
    assert next_experiment([recording], rig.explanation) is None
    assert recorded_unit({}) is None


def test_a_unit_without_room_is_a_remark(rig: AmbiguousRig) -> None:
    narrow = replace(load_rig(RIG), limits=RigLimits(pan_min_deg=1.0, pan_max_deg=-1.0))
    (explained,) = (
        with_next_experiment(explanation, narrow)
        for _, explanation in explain_boards({BoardId(rig.board): [rig.recording]})
        if isinstance(explanation, BoardExplanation)
    )
    assert explained.next_experiment is None
    assert "no motion program is proposed" in explained.remarks[-1]
    assert "allow no motion" in explained.remarks[-1]


def test_a_cause_that_is_requested_without_a_unit_is_a_remark(tmp_path: Path) -> None:
    recording = read_recording(record_turns(tmp_path / "r.mcap", SimulatedGyro()))
    ((_, explanation),) = explain_boards({recording.board_ids[0]: [recording]})
    assert isinstance(explanation, BoardExplanation)
    assert with_next_experiment(explanation).remarks == explanation.remarks
    explained = with_next_experiment(explanation, unseen=["g_sensitivity"])
    assert explained.remarks[-1] == (
        "no motion program is proposed, because the recordings have no motion unit"
    )


def test_a_program_shows_a_cause_that_the_recording_does_not(rig: AmbiguousRig) -> None:
    """survey-40 shows a step size of tilt from 0.0012 on; its typical size is 0.001."""
    proposed = next_experiment([rig.recording], rig.explanation, unseen=["step_resolution"])
    assert proposed is not None
    by_causes = {outlook.causes: outlook for outlook in proposed.outlooks}
    assert by_causes[("step_resolution",)].is_separated
    assert len(by_causes) == 2


def test_no_motion_shows_a_single_event_or_a_cause_that_is_in_the_fit(rig: AmbiguousRig) -> None:
    hidden = ["bias_step", "scale_quadratic", "clock_offset", "earth_rotation"]
    proposed = next_experiment([rig.recording], rig.explanation, unseen=hidden)
    assert proposed is not None
    pair, *alone = proposed.outlooks
    assert pair.is_separated
    assert [outlook.causes for outlook in alone] == [(cause,) for cause in hidden]
    assert not any(outlook.is_separated for outlook in alone)


def test_the_needed_distance_leaves_the_lower_tail_above_the_threshold() -> None:
    threshold = nats_for_sole_name(0.0)
    needed = _needed_nats(threshold)
    assert needed - 2.6 * (2.0 * needed) ** 0.5 == pytest.approx(threshold)


def test_the_command_writes_the_program_and_says_what_to_expect(
    rig: AmbiguousRig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, program = tmp_path / "findings", tmp_path / "separate.yaml"
    arguments = ["explain", str(rig.recording.path), "--out", str(out)]
    assert run([*arguments, "--rig", str(RIG)]) == 0
    printed = capsys.readouterr().out
    program_path = out / rig.board / "next-program.yaml"
    assert f"Next: record {program_path}" in printed
    assert "It separates scale_quadratic from scale_asymmetry: expected log Bayes" in printed
    proposed = parse_program(program_path.read_bytes(), program_path.name)
    assert proposed.description.startswith("separates")
    assert "next-program.yaml" in (out / rig.board / "report.html").read_text(encoding="utf-8")
    document = parse_findings((out / rig.board / "findings.yaml").read_bytes(), "findings.yaml")
    assert document.next_experiment is not None
    (pair,) = document.next_experiment.pairs
    assert pair.expected_log_bayes_factor is not None
    assert run([*arguments, "--next-program", str(program), "--next-seconds", "40"]) == 0
    assert program.exists()
    # An existing file is not replaced, and nothing is searched before that is known.
    assert run([*arguments, "--next-program", str(program)]) == 2
    assert "--next-program" in capsys.readouterr().err


def test_the_command_states_what_no_motion_shows(
    rig: AmbiguousRig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["explain", str(rig.recording.path), "--out", str(tmp_path)]
    causes = ["--next-cause", "bias_step", "--next-cause", "step_resolution"]
    assert run([*arguments, *causes]) == 0
    printed = capsys.readouterr().out
    assert "is sure to show bias_step" in printed
    assert "It shows step_resolution of the typical size" in printed
    assert run([*arguments, "--next-cause", "nothing"]) == 2


def test_the_command_proposes_nothing_if_asked(rig: AmbiguousRig, tmp_path: Path) -> None:
    recording = str(rig.recording.path)
    assert run(["explain", recording, "--out", str(tmp_path), "--next-seconds", "0"]) == 0
    assert not (tmp_path / rig.board / "next-program.yaml").exists()
    findings = (tmp_path / rig.board / "findings.yaml").read_bytes()
    assert parse_findings(findings, "findings.yaml").next_experiment is None
