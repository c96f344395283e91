"""`gyrorig check` in words: one verdict, and of every remark what to do about it."""

from dataclasses import replace
from pathlib import Path

import pytest

from gyrorig_protocol.recording.mcap.losses import Loss, LossCause
from gyrorig_protocol.recording.messages import SESSION_EVENT_TOPIC, EventKind, SessionEvent
from gyrorig_protocol.recording.writer import RecordingWriter
from gyrorig_solver import cli
from gyrorig_solver.check import RecordingHealth, health_problems, health_verdict
from gyrorig_solver.check.recording_health import BoardHealth, UnitHealth
from gyrorig_solver.estimate import ObservabilityReport

Captured = pytest.CaptureFixture[str]
ALL = ObservabilityReport(rank=12, of=12, condition=2.0, unobservable=(), reasons=())
REST = ObservabilityReport(
    rank=3,
    of=12,
    condition=1.0,
    unobservable=("scale.x", "scale.y", "scale.z"),
    reasons=("columns of the gain: nothing turned, so sweep both axes",),
)
BOARD = BoardHealth(
    board="GY80-1",
    sensor="L3G4200D",
    samples=1000,
    duration_s=10.0,
    rate_hz=100.0,
    lost=0,
    repeated=0,
    saturated=0,
    restarts=0,
    skew_ppm=3.0,
    latency_median_s=1e-3,
    latency_max_s=2e-3,
    clock_pings=10,
    observability=ALL,
)
UNIT = UnitHealth(100, 10.0, 0, (-90.0, 90.0), (-30.0, 30.0), 12, 0)
SOUND = RecordingHealth(
    name="one.mcap",
    complete=True,
    losses=(),
    notes=(),
    duration_s=10.0,
    topics={},
    dropped={},
    phases={},
    faults=(),
    unit=UNIT,
    boards=(BOARD,),
)
FAULTY = replace(
    BOARD, board="GY80-2", observability=None, fault="board GY80-2 does not answer. Fix its cable."
)


def with_board(**change: object) -> RecordingHealth:
    return replace(SOUND, boards=(replace(BOARD, **change),))  # type: ignore[arg-type]


def with_loss(cause: LossCause) -> RecordingHealth:
    return replace(SOUND, complete=False, losses=(Loss(cause, 0, 10, 1, "10 bytes are no use"),))


@pytest.mark.parametrize(
    ("health", "says"),
    [
        (SOUND, "sound"),
        (with_loss(LossCause.TRUNCATED), "usable, with remarks"),
        (with_board(lost=500), "usable, with remarks"),
        (with_board(observability=REST), "sound, but cannot calibrate all"),
        (
            with_board(observability=None, no_reference="there is no reference. Record the unit."),
            "sound, but cannot calibrate all",
        ),
        (with_board(observability=REST, restarts=1),
         "usable, with remarks, but cannot calibrate all"),
        (replace(SOUND, boards=()), "not usable"),
        (replace(SOUND, boards=(FAULTY,)), "not usable"),
        (replace(SOUND, boards=(BOARD, FAULTY)), "usable in part, without GY80-2"),
    ],
)  # fmt: skip
def test_the_verdict_is_one_of_few(health: RecordingHealth, says: str) -> None:
    assert health_verdict(health) == says


REMARKS = [
    *((with_loss(cause), "10 bytes are no use") for cause in LossCause),
    (replace(SOUND, dropped={"/a": 3}), "Free space"),
    (replace(SOUND, faults=("board GY80-1 has sent no sample for 2 s",)), "gyrorigd doctor"),
    (replace(SOUND, boards=()), "Connect a board"),
    (replace(SOUND, boards=(FAULTY,)), "Fix its cable"),
    (replace(SOUND, unit=replace(UNIT, unsynchronised=3)), "Check the cable of the unit"),
    (with_board(lost=500), "Lower the board's output rate, raise the baud rate"),
    (with_board(lost=500, link="can"), "raise the bit rate of the bus"),
    (with_board(lost=500, link="file"), "ask the person who recorded the file"),
    (with_board(saturated=5), "larger full scale"),
    (with_board(repeated=500), "Read the sensor on its data-ready signal"),
    (with_board(repeated=500, link="file"), "Use the samples as measured"),
    (with_board(restarts=2), "Check the board's supply"),
    (with_board(restarts=2, link="file"), "joins several recordings"),
    (with_board(clock_steps=2), "Do not suspend"),
    (with_board(clock_steps=2, link="file"), "Import the rows before and after each jump"),
    (with_board(observability=REST), "sweep both axes"),
    (with_board(observability=replace(REST, reasons=())), "Turn the board about every axis"),
    (with_board(observability=None, no_reference="no reference. Record the unit."), "Record the"),
]


@pytest.mark.parametrize(("health", "remedy"), REMARKS)
def test_every_remark_says_what_to_do(health: RecordingHealth, remedy: str) -> None:
    (remark,) = health_problems(health)
    assert remedy in remark
    what, _, to_do = remark.partition(". ")
    assert len(what) > 8
    assert len(to_do) > 8
    assert "\n" not in remark


def test_a_sound_recording_has_no_remark() -> None:
    assert health_problems(SOUND) == ()


def test_a_recording_without_a_board_is_not_usable(tmp_path: Path, capsys: Captured) -> None:
    metadata = {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}
    writer = RecordingWriter(tmp_path / "empty.mcap", {"gyrorig": metadata})
    writer.write(SESSION_EVENT_TOPIC, SessionEvent(1, int(EventKind.NOTE), "", "alone"), 1, 1)
    writer.close()
    assert cli.run(["check", str(tmp_path / "empty.mcap")]) == 4
    text = capsys.readouterr().out
    assert text.startswith("empty.mcap: not usable;")
    assert "Connect a board" in text
