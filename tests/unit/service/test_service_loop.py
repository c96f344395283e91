"""The main loop in simulated time: start and end of sessions, motion lock."""

import gc
import json
from collections.abc import Callable
from typing import Any

import pytest

from gyrorig_daemon.links.ports.port_hub import PortsGoneError
from gyrorig_daemon.recorder import Recorder
from gyrorig_daemon.service.persistent_state import PersistentState
from gyrorig_daemon.service.service_loop import LoopExit
from gyrorig_daemon.session.session import Session
from gyrorig_protocol.errors import GyrorigError, MachineError, UsageError
from gyrorig_protocol.recording.messages import EventKind, SessionEvent
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.recording.standard_messages import Diagnostics

Make = Callable[..., Any]

FAR = "name: far\nsteps:\n  - move: {pan_deg: 150.0, speed_deg_s: 10.0}\n"
LIMIT = b"!P"
SCHEDULED = (
    "rig: test\nptu: {port: emulated, baud: 115200, poll: {rate_hz: 10}}\n"
    "boards: [{id: B-1, port: emulated, baud: 460800}]\nemulator: {command_time_ms: 5.0}\n"
    "schedule: [{name: often, program: short.yaml, every_h: 0.01}]\n"
)
TWO_BOARDS = """
rig: test
ptu: {port: emulated, baud: 115200, poll: {rate_hz: 10}}
boards:
  - {id: B-1, port: emulated, baud: 460800}
  - {id: B-2, port: emulated, baud: 460800}
emulator: {command_time_ms: 5.0}
service: {board_patience_s: 5.0}
"""


def events(recording: Recording) -> list[SessionEvent]:
    return [m for m in recording.messages("/session/event") if isinstance(m, SessionEvent)]


def say(bench: Any, data: bytes) -> Callable[[], None]:
    """Have the unit say something that nobody asked for."""

    def plan() -> None:
        bench.hub._push(bench.hub.now_ns(), "ptu", data)

    return plan


def test_a_job_is_carried_out_and_put_aside(make_bench: Make) -> None:
    bench = make_bench()
    bench.at(3.0, lambda: bench.put(session="first"))
    assert bench.serve(15.0) is LoopExit.END
    (path,) = bench.recordings()
    recording = read_recording(path)
    assert recording.is_complete
    assert recording.metadata["gyrorig"]["session"] == "first"
    assert len(recording.array("/board/B-1/imu_raw")) > 200
    (result,) = bench.results("done")
    document = json.loads(result.read_text())
    assert (document["result"], document["session"], document["recording"]) == (
        "done",
        "first",
        str(path),
    )
    assert (document["parts"], document["messages_lost"]) == ([path.name], 0)
    assert bench.state_at(2.0)["state"] == "ready"
    assert bench.state_at(5.0)["state"] == "running"
    assert bench.state_at(14.0)["state"] == "ready"
    assert bench.parts.counts.sessions_done == 1
    assert bench.is_still()


def test_the_unit_is_halted_before_anything_else_and_before_readiness(make_bench: Make) -> None:
    bench = make_bench()
    bench.rig.ptu.receive(b"PS200 PP3000 ", bench.hub.now_ns())  # somebody left it turning
    ready_at: list[float] = []
    sent = bench.notifier._send

    def note(text: str) -> None:
        sent(text)
        if text == "READY=1":
            ready_at.append(bench.pan_deg())

    bench.notifier._send = note
    bench.serve(20.0)
    assert bench.rig.stage.pan.commands[1][0] == "halt"
    assert ready_at == [pytest.approx(bench.pan_deg(), abs=1e-9)]  # it stood by then
    assert bench.pan_deg() < 3.0


def test_jobs_go_in_the_order_of_their_names(make_bench: Make) -> None:
    bench = make_bench()
    for name in ("one", "two", "three"):
        bench.put(session=name)
    timers = list(bench.opened.pump._timers)
    bench.serve(40.0, bench.ended("done", 3))
    names = [json.loads(path.read_text())["session"] for path in bench.results("done")]
    assert names == ["one", "two", "three"]
    sessions = [read_recording(p).metadata["gyrorig"]["session"] for p in bench.recordings()]
    assert sessions == ["one", "two", "three"]
    assert list(bench.opened.pump._timers) == timers  # nothing is left of them
    gc.collect()
    assert not [thing for thing in gc.get_objects() if isinstance(thing, Session | Recorder)]


def test_a_recording_tells_of_its_own_losses_only(make_bench: Make, faulty_board: Any) -> None:
    bench = make_bench(change=faulty_board(drop_frame_every=20))
    bench.at(8.0, bench.put)
    bench.serve(30.0, bench.ended("done", 1))
    recording = read_recording(*bench.recordings())
    *_, last = (m for m in recording.messages("/diagnostics") if isinstance(m, Diagnostics))
    values = {status.name: status.values for status in last.status}["board/B-1"]
    counts = bench.statuses[-1]["boards"][0]["counts"]
    assert 5 <= int(values["missing"]) <= counts["missing"] - 25
    assert int(values["samples"]) < counts["samples"] - 400


def test_a_stop_in_motion_halts_closes_and_ends(make_bench: Make) -> None:
    bench = make_bench()
    bench.put(FAR)
    assert bench.serve(6.0) is LoopExit.END
    assert 2.0 < bench.pan_deg() < 60.0
    assert bench.is_still()
    assert bench.now_s() - 5.0 < 6.0 + 3.0  # of 30 that systemd allows
    recording = read_recording(*bench.recordings())
    assert recording.is_complete
    (result,) = bench.results("failed")
    assert "SIGTERM. The unit is halted" in json.loads(result.read_text())["reason"]
    assert bench.parts.counts.sessions_stopped == 1


def test_a_job_of_which_nothing_was_done_waits_again(make_bench: Make) -> None:
    bench = make_bench()
    begin_ns = bench.hub.now_ns()
    bench.at(5.0, bench.put)  # and just then, before it is known again, the unit goes away
    bench.hub.unplug("ptu", begin_ns + 5_600_000_000, begin_ns + 9_000_000_000)
    bench.serve(30.0, bench.ended("done", 1))
    assert any("could not start and waits" in line for line in bench.log)
    assert len(bench.results("done")) == 1
    assert bench.results("failed") == []
    assert len(bench.recordings()) == 1


def test_a_fault_of_the_motion_holds_everything_until_cleared(make_bench: Make) -> None:
    bench = make_bench()
    bench.put(FAR, session="bad")
    bench.put(session="waits", home=True)
    bench.at(5.0, say(bench, LIMIT))
    bench.at(20.0, bench.orders.clear.set)
    bench.serve(90.0, bench.ended("done", 1))
    first, second = (read_recording(path) for path in bench.recordings())
    fault_events = events(first)
    assert any(e.kind == EventKind.FAULT and "reached a limit" in e.text for e in fault_events)
    begun_s = [int(e.host_time_ns) * 1e-9 for e in fault_events]
    rows = first.array("/board/B-1/imu_raw")["log_time"]
    # the recording went on after the halt, until it was cleared
    assert int(rows[-1]) * 1e-9 - begun_s[-1] > 8.0
    assert first.is_complete
    assert bench.state_at(10.0)["state"] == "fault"
    assert bench.state_at(10.0)["queue"]["waiting"] == 1
    (result,) = bench.results("failed")
    assert json.loads(result.read_text())["session"] == "bad"
    assert second.metadata["gyrorig"]["session"] == "waits"
    assert bench.parts.counts.motion_faults == 1
    (released,) = [line for line in bench.log if line.startswith("Motion lock released: ")]
    assert "its pan axis reached a limit" in released


def test_ports_that_are_lost_after_a_fault_leave_a_closed_recording(make_bench: Make) -> None:
    bench = make_bench()
    bench.put(FAR)
    bench.at(5.0, say(bench, LIMIT))
    read = bench.hub.read

    def lose(deadline_ns: int) -> object:
        if bench.now_s() > 5.0 + 9.0:
            raise PortsGoneError("the acquisition process ended", "start again")
        return read(deadline_ns)

    bench.hub.read = lose
    with pytest.raises(PortsGoneError):
        bench.serve(60.0)
    assert read_recording(*bench.recordings()).is_complete
    (result,) = bench.results("failed")
    assert "the acquisition process ended" in json.loads(result.read_text())["reason"]
    assert bench.parts.persistent.motion_lock is not None


def test_after_lost_steps_nothing_moves_without_homing(make_bench: Make) -> None:
    bench = make_bench()
    bench.put(FAR)
    bench.at(5.0, say(bench, LIMIT))
    bench.at(12.0, bench.orders.clear.set)
    bench.at(13.0, lambda: bench.put(session="unsure"))
    bench.at(20.0, lambda: bench.put(session="homed", home=True))
    bench.at(21.0, lambda: bench.put(session="sure"))
    bench.serve(120.0, bench.ended("done", 2))
    failed = [json.loads(path.read_text()) for path in bench.results("failed")]
    assert [f["session"] for f in failed][1:] == ["unsure"]
    assert "--home" in failed[1]["reason"]
    sessions = [json.loads(path.read_text())["session"] for path in bench.results("done")]
    assert sessions == ["homed", "sure"]


def test_an_operators_halt_stops_the_session_and_holds(make_bench: Make) -> None:
    bench = make_bench()
    bench.put(FAR)
    bench.at(6.0, lambda: bench.orders.request_halt("user 1000"))
    bench.at(8.0, bench.put)
    bench.at(14.0, bench.orders.clear.set)
    bench.serve(40.0, bench.ended("done", 1))
    assert "an operator's halt (user 1000)" in bench.state_at(10.0)["reason"]
    assert bench.state_at(10.0)["state"] == "fault"
    assert len(bench.results("done")) == 1
    assert len(bench.recordings()) == 2


@pytest.mark.parametrize("is_cleared_last", [True, False])
def test_a_halt_and_its_release_are_carried_out_in_order(
    make_bench: Make, is_cleared_last: bool
) -> None:
    bench = make_bench()
    bench.put(FAR)
    first_s, last_s = 6.0, 6.05
    halt_s, clear_s = (first_s, last_s) if is_cleared_last else (last_s, first_s)
    bench.at(halt_s, lambda: bench.orders.request_halt("user 0"))
    bench.at(clear_s, bench.orders.clear.set)
    bench.serve(14.0)
    assert bench.parts.counts.sessions_stopped == 1
    assert bench.state_at(12.0)["state"] == ("ready" if is_cleared_last else "fault")
    assert (bench.parts.persistent.motion_lock is None) == is_cleared_last


def test_an_operators_halt_between_sessions(make_bench: Make) -> None:
    bench = make_bench()
    bench.at(4.0, lambda: bench.orders.request_halt("user 0"))
    bench.at(5.0, bench.put)
    bench.serve(12.0)
    assert bench.state_at(10.0)["state"] == "fault"
    assert bench.recordings() == []
    again = PersistentState(bench.state.persistent_state, bench.utc_s())  # a restart has not looked
    assert again.motion_lock == bench.parts.persistent.motion_lock
    assert again.motion_lock is not None


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("name: p\nsteps:\n  - move: {pan_deg: 900.0}\n", "limits are"),
        ("name: p\nsteps:\n  - move: {pan_deg: 5.0, speed_deg_s: 900.0}\n", "limits are"),
    ],
)
def test_a_program_that_does_not_fit_is_refused_before_it_moves(
    make_bench: Make, program: str, words: str
) -> None:
    bench = make_bench()
    bench.put(program)
    bench.at(5.0, bench.put)
    bench.serve(25.0, bench.ended("done", 1))
    (result,) = bench.results("failed")
    assert words in json.loads(result.read_text())["reason"]
    assert len(bench.results("done")) == 1  # no hold: a person has to mend the job only
    assert len(bench.recordings()) == 1


def test_a_board_that_is_missing_is_waited_for_and_then_left_out(make_bench: Make) -> None:
    bench = make_bench(TWO_BOARDS)
    bench.hub.unplug("board:B-2", bench.hub.now_ns(), bench.hub.now_ns() + 14_000_000_000)
    bench.put("name: p\nsteps:\n  - rest: {seconds: 20.0}\n  - move: {pan_deg: 5.0}\n", session="s")
    bench.serve(60.0)
    assert bench.state_at(4.0)["reason"] == "no data from board B-2. Check its cable and its power"
    assert bench.state_at(9.0)["state"] == "running"
    recording = read_recording(*bench.recordings())
    assert "gyrorig.board.B-2" in recording.metadata  # it came while the session ran
    rows = recording.array("/board/B-2/imu_raw")
    first = recording.array("/board/B-1/imu_raw")
    assert 500 < len(rows) < len(first) - 500
    assert any("takes part from now on" in e.text for e in events(recording))


@pytest.mark.parametrize("error_class", [UsageError, MachineError])
def test_a_board_that_joins_late_and_cannot_take_part_is_left_out(
    make_bench: Make, monkeypatch: pytest.MonkeyPatch, error_class: type[GyrorigError]
) -> None:
    bench = make_bench(TWO_BOARDS)
    board = next(b for b in bench.opened.boards if str(b.board_id) == "B-2")
    metadata = type(board).metadata

    def refuse(link: Any) -> Any:
        if link is board:
            raise error_class("board B-2 has no gyroscope", "check its firmware")
        return metadata(link)

    monkeypatch.setattr(type(board), "metadata", refuse)
    bench.hub.unplug("board:B-2", bench.hub.now_ns(), bench.hub.now_ns() + 14_000_000_000)
    bench.put("name: p\nsteps:\n  - rest: {seconds: 20.0}\n  - move: {pan_deg: 5.0}\n")
    bench.serve(60.0, bench.ended("done", 1))
    assert bench.results("failed") == []
    recording = read_recording(*bench.recordings())
    (fault,) = [event for event in events(recording) if event.kind == EventKind.FAULT]
    assert "board B-2 cannot take part. Board B-2 has no gyroscope" in fault.text
    assert "gyrorig.board.B-2" not in recording.metadata
    assert len(recording.array("/board/B-1/imu_raw")) > 2000


def test_a_disk_without_room_is_waited_for(make_bench: Make) -> None:
    bench = make_bench()
    free_bytes = bench.state.free_bytes
    bench.state.free_bytes = lambda: 5_000_000
    bench.put()
    bench.at(6.0, lambda: setattr(bench.state, "free_bytes", free_bytes))
    bench.serve(20.0, bench.ended("done", 1))
    assert bench.state_at(5.0)["state"] == "waiting"
    assert "0.01 GB are free" in bench.state_at(5.0)["reason"]
    assert bench.results("failed") == []


def test_a_unit_that_is_away_is_waited_for_and_halted_when_it_comes(make_bench: Make) -> None:
    bench = make_bench()
    begin_ns = bench.hub.now_ns()
    bench.rig.ptu.receive(b"PS100 PP3000 ", begin_ns)
    bench.hub.unplug("ptu", begin_ns, begin_ns + 10_000_000_000)
    bench.put()
    bench.serve(40.0, bench.ended("done", 1))
    assert bench.state_at(6.0)["state"] == "waiting"
    assert bench.notifier.words.count("READY=1") == 1
    halted_s = next(order[1] for order in bench.rig.stage.pan.commands if order[0] == "halt")
    assert 9.9 < halted_s < 12.0
    assert len(bench.results("done")) == 1


def test_a_unit_unplugged_in_motion_ends_the_session_and_is_halted_on_its_return(
    make_bench: Make,
) -> None:
    bench = make_bench()
    bench.put(FAR, session="lost")
    begin_ns = bench.hub.now_ns()
    bench.hub.unplug("ptu", begin_ns + 6_000_000_000, begin_ns + 9_000_000_000)
    bench.at(16.0, bench.orders.clear.set)
    bench.at(17.0, lambda: bench.put(session="again"))
    bench.serve(70.0, bench.ended("done", 1))
    assert bench.is_still()
    assert bench.state_at(14.0)["state"] == "fault"
    (result,) = bench.results("failed")
    assert "unplugged" in json.loads(result.read_text())["reason"]
    orders = [order for order in bench.rig.stage.pan.commands if order[0] == "halt"]
    assert any(9.0 <= order[1] < 12.0 for order in orders)
    assert [json.loads(p.read_text())["session"] for p in bench.results("done")] == ["again"]


def test_a_unit_that_was_away_for_a_moment_is_asked_who_it_is(make_bench: Make) -> None:
    bench = make_bench()
    begin_ns = bench.hub.now_ns()
    bench.hub.unplug("ptu", begin_ns + 5_000_000_000, begin_ns + 5_020_000_000)
    bench.serve(12.0)
    assert bench.parts.counts.unit_lost == 1
    halts_s = [order[1] for order in bench.rig.stage.pan.commands if order[0] == "halt"]
    assert any(5.0 < halt_s < 9.0 for halt_s in halts_s)
    assert bench.state_at(11.0)["unit"]["state"] == "stands"


def test_a_silent_unit_is_asked_for_ever_and_its_port_opened_anew(make_bench: Make) -> None:
    bench = make_bench()
    hear = bench.rig.ptu.receive
    bench.at(5.0, lambda: setattr(bench.rig.ptu, "receive", lambda data, at_ns: None))
    bench.at(30.0, lambda: setattr(bench.rig.ptu, "receive", hear))
    bench.serve(45.0)
    assert bench.state_at(25.0)["unit"]["state"] == "silent"
    assert bench.state_at(29.0)["counts"]["unit_reopened"] >= 1
    assert bench.state_at(44.0)["unit"]["state"] == "stands"
    assert bench.state_at(44.0)["counts"]["unit_lost"] == 1


def test_a_reload_reopens_when_idle_and_a_broken_one_changes_nothing(make_bench: Make) -> None:
    bench = make_bench()
    bench.refusal = "rig.yaml is not a YAML document"
    bench.at(3.0, bench.orders.reload.set)
    bench.put(FAR)
    bench.at(8.0, lambda: setattr(bench, "refusal", ""))
    bench.at(9.0, bench.orders.reload.set)
    assert bench.serve(60.0) is LoopExit.REOPEN
    assert 5.0 + 15.0 < bench.now_s() < 5.0 + 35.0  # not before the session's end
    assert bench.parts.counts.reloads == bench.parts.counts.reloads_refused == 1
    assert len(bench.results("done")) == 1
    assert [w.split("\n")[0] for w in bench.notifier.words if "RELOADING" in w or "READY" in w] == [
        "READY=1",
        "RELOADING=1",
        "READY=1",
        "RELOADING=1",
        "READY=1",
    ]


def test_the_wall_clock_may_jump_both_ways_in_a_session(make_bench: Make) -> None:
    bench = make_bench()
    bench.put("name: p\nsteps:\n  - rest: {seconds: 10.0}\n", session="jumps")
    bench.at(5.0, lambda: setattr(bench, "stepped_s", 3.0e7))
    bench.at(8.0, lambda: setattr(bench, "stepped_s", -7.0e8))
    bench.at(14.5, lambda: bench.put(session="jumps"))
    bench.serve(40.0, bench.ended("done", 2))
    first, second = sorted(
        (read_recording(path) for path in bench.recordings()),
        key=lambda r: int(r.metadata["gyrorig"]["anchor_monotonic_raw_ns"]),
    )
    rows = first.array("/board/B-1/imu_raw")["log_time"].astype("i8")
    assert (rows[1:] >= rows[:-1]).all()
    assert 9.0 < (rows[-1] - rows[0]) * 1e-9 < 14.0
    steps = [e.text for e in events(first) if "system time" in e.text]
    assert [text.split()[-2] for text in steps] == ["+30000000.000", "-730000000.000"]
    assert bench.parts.counts.clock_steps == 2
    real_s = first.array("/host/clock")["realtime"]["sec"].astype("i8")
    assert real_s.max() - real_s.min() > 7e8  # the table has both clocks
    anchor = int(second.metadata["gyrorig"]["anchor_utc_ns"]) * 1e-9
    assert anchor < 1_790_000_000 - 6.9e8  # it went back in time, and lies beside the first
    assert len(bench.results("done")) == 2


def test_two_sessions_of_one_name_in_one_second_do_not_meet(make_bench: Make) -> None:
    bench = make_bench()
    bench.at(3.0, lambda: bench.put(session="same"))
    bench.at(8.0, lambda: setattr(bench, "stepped_s", bench.stepped_s - 5.0))
    bench.at(8.0, lambda: bench.put(session="same"))
    bench.serve(25.0, bench.ended("done", 2))
    assert len(bench.results("done")) == 2
    assert len(bench.recordings()) == 2


def test_a_scheduled_session_that_cannot_begin_is_tried_again(make_bench: Make) -> None:
    bench = make_bench(SCHEDULED.replace("0.01", "1.0"))
    bench.parts.persistent.steps_are_sure = False
    bench.at(20.0, lambda: setattr(bench.parts.persistent, "steps_are_sure", True))
    bench.serve(60.0, lambda: len(bench.recordings()) == 1)
    assert bench.parts.counts.sessions_put_off == 1
    assert bench.parts.counts.sessions_failed == 0
    (waits,) = [line for line in bench.log if "could not start and waits" in line]
    assert "for at least 30 s" in waits
    assert len(bench.recordings()) == 1


def test_a_rig_that_is_lost_is_opened_anew(make_bench: Make) -> None:
    bench = make_bench()
    bench.at(
        4.0, lambda: setattr(bench.parts, "reopen_reason", lambda: "the emulated rig has ended")
    )
    assert bench.serve(60.0) is LoopExit.REOPEN
    assert "The emulated rig has ended. It is started again." in bench.log


def test_a_scheduled_program_that_has_become_too_long_is_skipped(make_bench: Make) -> None:
    bench = make_bench(SCHEDULED)
    bench.parts.read_program = lambda name: (
        b"name: p\nsteps:\n" + b"  - rest: {seconds: 1}\n" * 3_000
    )
    bench.serve(20.0)
    assert bench.recordings() == []
    assert "the daemon takes at most 64000 bytes" in " ".join(bench.log)


def test_a_schedule_is_kept(make_bench: Make) -> None:
    bench = make_bench(SCHEDULED)
    bench.serve(80.0, lambda: len(bench.recordings()) == 3)  # at once, at 36 s and at 72 s
    names = [read_recording(p).metadata["gyrorig"]["session"] for p in bench.recordings()]
    assert len(names) == 3
    assert all(name.startswith("often-") for name in names)
    assert bench.state_at(20.0)["schedule"][0]["due_in_s"] == pytest.approx(19.0, abs=4.0)
