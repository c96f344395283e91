"""Experiments: what starts one, what limits it and what ends it. The solver is the real one."""

import json
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gyrorig_daemon.cli import run
from gyrorig_daemon.config import parse_rig
from gyrorig_daemon.service import explanation_process
from gyrorig_daemon.service.experiment import Experiment, RoundOutcome, limits_document
from gyrorig_daemon.service.explanation_process import (
    KILL_AFTER_S,
    MEMORY_BYTES,
    ExplanationProcess,
    ExplanationReport,
)
from gyrorig_daemon.service.jobs import UntilNamed, parse_job
from gyrorig_daemon.service.service_loop import LoopExit
from gyrorig_daemon.service.status_screen import render_status
from gyrorig_protocol.errors import UsageError
from gyrorig_solver.plan import load_rig

Make = Callable[..., Any]

REAL_RIG = "rig: r\nptu: {port: /dev/ttyUSB0}\nboards: [{id: B-1, port: emulated}]\n"
LONG = "name: long\nsteps:\n  - rest: {seconds: 70.0}\n"
PROPOSED = b"name: proposed\nsteps:\n  - rest: {seconds: 2.0}\n"


def result_of(bench: Any, folder: str) -> dict[str, Any]:
    (path,) = bench.results(folder)
    document: dict[str, Any] = json.loads(path.read_text())
    return document


def is_explaining(bench: Any) -> bool:
    status = bench.daemon.state.experiment()
    return status is not None and status["step"] == "explaining"


def test_a_job_states_its_limits(tmp_path: Path) -> None:
    text = b"schema: gyrorig/job/1\nprogram: |\n  name: p\n  steps: [rest: {seconds: 1.0}]\n"
    assert parse_job(text, "j.yaml").until_named is None
    limited = parse_job(text + b"until_named: {minutes: 5, rounds: 2}\n", "j.yaml")
    assert limited.until_named == UntilNamed(5.0, 2, 120.0)
    for wrong in (b"{minutes: 0}", b"{minutes: 2000}", b"{rounds: 0}", b"{rounds: 99}", b"{x: 1}"):
        with pytest.raises(UsageError):
            parse_job(text + b"until_named: " + wrong + b"\n", "j.yaml")


def test_enqueue_an_experiment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "queue").mkdir()
    program = tmp_path / "p.yaml"
    program.write_text(LONG)
    command = ["enqueue", "--program", str(program), "--state", str(tmp_path), "--json"]
    assert run([*command, "--until-named", "--minutes", "12", "--rounds", "3"]) == 0
    path = Path(json.loads(capsys.readouterr().out)["file"])
    assert parse_job(path.read_bytes(), path.name).until_named == UntilNamed(12.0, 3, 120.0)


def test_a_real_unit_needs_the_consent_of_its_rig_file(make_bench: Make) -> None:
    bench = make_bench()
    bench.put(until_named=UntilNamed())
    refused = Experiment(parse_rig(REAL_RIG, "rig.yaml"), bench.parts)
    refused.begin(bench.parts.queue.take_next())
    assert not refused.is_active
    assert "does not permit motion programs that the solver" in result_of(bench, "failed")["reason"]
    assert "run_proposed_programs: true" in result_of(bench, "failed")["reason"]
    bench.put(until_named=UntilNamed())
    consent = REAL_RIG + "service: {run_proposed_programs: true}\n"
    permitted = Experiment(parse_rig(consent, "rig.yaml"), bench.parts)
    permitted.begin(bench.parts.queue.take_next())
    assert permitted.is_active
    assert permitted.next_round() is not None


def test_the_solver_gets_the_limits_of_the_rig_file(tmp_path: Path) -> None:
    assert limits_document(parse_rig(REAL_RIG, "rig.yaml")) == b""
    narrow = REAL_RIG.replace("}", ", limits: {pan_max_deg: 40.0, speed_deg_s: 20.0}}", 1)
    (tmp_path / "rig.yaml").write_bytes(limits_document(parse_rig(narrow, "rig.yaml")))
    unit = load_rig(tmp_path / "rig.yaml").unit
    assert unit.pan.high_deg == 40.0
    assert unit.pan.low_deg < -100.0
    assert unit.tilt.fastest_deg_s == 20.0


def test_no_session_begins_that_would_end_later(make_bench: Make) -> None:
    bench = make_bench()
    bench.at(3.0, lambda: bench.put(LONG, until_named=UntilNamed(minutes=1.0)))
    assert bench.serve(40.0, enough=bench.ended("failed", 1)) is LoopExit.END
    assert "takes 70 s, but 60 s remain" in result_of(bench, "failed")["reason"]
    assert bench.recordings() == []


def test_a_second_job_of_the_same_name_has_a_folder_of_its_own(make_bench: Make) -> None:
    """Before, its solver was not started, because the folder existed."""
    bench = make_bench()
    bench.put(until_named=UntilNamed())
    job = bench.parts.queue.take_next()
    (bench.state.experiments / job.name / "round-1").mkdir(parents=True)
    experiment = bench.daemon._experiment
    experiment.begin(job)
    experiment.end_round(RoundOutcome("done", "", ()))
    assert is_explaining(bench)
    assert (bench.state.experiments / f"{job.name}-2" / "round-1").is_dir()
    experiment.abandon("the end of the test")


def test_a_recording_without_a_cause_ends_it(make_bench: Make) -> None:
    bench = make_bench()
    bench.waits_for_solver = True
    bench.at(3.0, lambda: bench.put(until_named=UntilNamed(), session="short"))
    assert bench.serve(400.0, enough=bench.ended("done", 1)) is LoopExit.END
    document = result_of(bench, "done")
    (path,) = bench.recordings()
    (round_entry,) = document["experiment"]["rounds"]
    assert round_entry["recordings"] == [str(path)]
    assert Path(round_entry["findings"][0]).is_file()
    assert round_entry["causes"] == document["experiment"]["causes"] == []
    assert document["experiment"]["outcome"] == "no_cause"
    assert bench.parts.counts.sessions_done == bench.parts.counts.experiments_done == 1
    assert bench.daemon.state.experiment() is None
    assert bench.parts.housekeeping.protected == ()


def test_a_solver_that_cannot_start_ends_it(make_bench: Make) -> None:
    bench = make_bench()
    bench.state.experiments.write_text("a file instead of the folder")
    bench.at(3.0, lambda: bench.put(until_named=UntilNamed()))
    assert bench.serve(60.0, enough=bench.ended("failed", 1)) is LoopExit.END
    document = result_of(bench, "failed")
    (path,) = bench.recordings()
    assert document["experiment"]["rounds"] == [{"recordings": [str(path)]}]
    assert "the solver cannot be started in" in document["reason"]
    assert bench.parts.counts.sessions_done == bench.parts.counts.experiments_failed == 1
    assert bench.daemon.state.experiment() is None
    assert bench.parts.housekeeping.protected == ()


def test_a_halt_ends_it_while_the_solver_runs(make_bench: Make) -> None:
    bench = make_bench()
    seen: list[dict[str, Any]] = []
    pids: list[int] = []

    def halt_once() -> bool:
        if is_explaining(bench) and not pids:
            pids.append(bench.solver().pid)
            seen.append(bench.statuses[-1])
            bench.orders.request_halt("user 0")
        return bool(bench.results("failed"))

    bench.at(3.0, lambda: bench.put(until_named=UntilNamed()))
    bench.at(4.0, lambda: bench.put(session="next"))  # waits until the experiment has ended
    assert bench.serve(4000.0, enough=halt_once) is LoopExit.END
    assert "an operator's halt" in result_of(bench, "failed")["reason"]
    assert not Path(f"/proc/{pids[0]}").exists()
    assert bench.parts.persistent.motion_lock is not None
    assert len(bench.parts.queue.waiting_jobs()) == 1
    assert bench.daemon.state.experiment() is None


def test_a_halt_in_a_session_ends_it(make_bench: Make) -> None:
    bench = make_bench()
    bench.at(3.0, lambda: bench.put(LONG, until_named=UntilNamed(minutes=5.0)))
    bench.at(20.0, lambda: bench.orders.request_halt("user 0"))
    bench.serve(60.0, enough=bench.ended("failed", 1))
    document = result_of(bench, "failed")
    assert "Round 1: Stopped by an operator's halt" in document["reason"]
    assert len(document["experiment"]["rounds"][0]["recordings"]) == 1
    running = [s for s in bench.statuses if s["experiment"] is not None]
    assert running[-1]["experiment"]["step"] == "recording"
    assert "experiment  recording, session 1 of at most 5" in render_status(running[-1])


def test_the_end_of_the_service_ends_it(make_bench: Make) -> None:
    bench = make_bench()
    bench.at(3.0, lambda: bench.put(LONG, until_named=UntilNamed(minutes=5.0)))
    assert bench.serve(20.0) is LoopExit.END
    assert "SIGTERM" in result_of(bench, "failed")["reason"]


def report(folder: Path, one_of: list[str], seconds: float | None) -> ExplanationReport:
    """What `gyrorig explain --json` prints for one board, and the program that it writes."""
    board = folder / "B-1"
    board.mkdir(parents=True, exist_ok=True)
    (board / "next-program.yaml").write_bytes(PROPOSED)
    cause = {"cause": "scale_quadratic", "part": "board", "where": "z", "one_of": one_of}
    findings: dict[str, Any] = {"verdict": "explained", "causes": [cause]}
    if seconds is not None:
        findings["next_experiment"] = {"program": "next-program.yaml", "seconds": seconds}
    plain = {
        "boards": [{"board": "B-1", "file": str(board / "findings.yaml"), "findings": findings}],
        "failed": [],
        "exit_code": 0,
    }
    return msgspec.json.decode(json.dumps(plain).encode(), type=ExplanationReport)


@pytest.mark.parametrize(
    ("one_of", "seconds", "rounds", "outcome"),
    [
        ([], None, 5, "named"),
        (["scale_asymmetry"], None, 5, "not_separable"),
        (["scale_asymmetry"], 300.0, 5, "budget"),
        (["scale_asymmetry"], 100.0, 1, "rounds"),
        (["scale_asymmetry"], 100.0, 5, ""),
    ],
)
def test_what_a_report_leads_to(
    make_bench: Make, one_of: list[str], seconds: float | None, rounds: int, outcome: str
) -> None:
    bench = make_bench()
    bench.put(until_named=UntilNamed(4.0, rounds), session="monday")
    experiment = Experiment(bench.opened.config, bench.parts)
    experiment.begin(bench.parts.queue.take_next())
    progress = experiment._progress
    assert progress is not None
    explained = report(bench.state.root, one_of, seconds)
    progress.boards = explained.boards
    experiment._judge(progress, explained)
    assert experiment.is_active == (outcome == "")
    if outcome:
        document = result_of(bench, "done")["experiment"]
        assert document["outcome"] == outcome
        assert document["causes"][0]["one_of"] == one_of
        return
    job = experiment.next_round()
    assert job is not None
    assert (job.program.name, job.session, job.is_round) == ("proposed", "monday-2", True)
    assert job.limit_s == pytest.approx(240.0)


def test_a_unit_that_stays_away_uses_the_minutes(make_bench: Make) -> None:
    bench = make_bench()
    bench.put(until_named=UntilNamed(minutes=1.0))
    experiment = Experiment(bench.opened.config, bench.parts)
    experiment.begin(bench.parts.queue.take_next())
    bench.opened.pump.run_until(bench.hub.now_ns() + 61_000_000_000)
    experiment.watch("pan-tilt unit: absent")
    assert "the unit" not in result_of(bench, "failed")["reason"]
    assert "1 min are used, and pan-tilt unit: absent" in result_of(bench, "failed")["reason"]


def test_a_session_that_was_not_begun_puts_the_job_back(make_bench: Make) -> None:
    bench = make_bench()
    path = bench.put(until_named=UntilNamed())
    experiment = Experiment(bench.opened.config, bench.parts)
    experiment.begin(bench.parts.queue.take_next())
    experiment.end_round(RoundOutcome("waits", "the port is gone", ()))
    assert not experiment.is_active
    assert bench.parts.queue.waiting_jobs() == [path.stem]


def test_the_solver_is_limited_and_its_fault_is_reported(tmp_path: Path) -> None:
    recording = tmp_path / "bad.mcap"
    recording.write_bytes(b"no recording")
    process = ExplanationProcess([recording], tmp_path / "out", b"rig: r\n", 0.0, 60.0)
    pid = process._process.pid
    assert resource.prlimit(pid, resource.RLIMIT_AS) == (MEMORY_BYTES, MEMORY_BYTES)
    assert resource.prlimit(pid, resource.RLIMIT_CPU) == (60, 60 + KILL_AFTER_S)
    end_s = time.monotonic() + 300.0
    while not process.poll():
        assert time.monotonic() < end_s
        time.sleep(0.05)
    with pytest.raises(Exception, match=r"the recordings could not be explained: .*rig"):
        process.report()
    process.close()


def test_the_limit_of_time_is_the_reason_of_an_explanation_that_it_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endless = (sys.executable, "-c", "while True: pass")
    monkeypatch.setattr(explanation_process, "module_command", lambda *_: [*endless])
    process = ExplanationProcess([], tmp_path / "out", b"", 0.0, 1.0)
    end_s = time.monotonic() + 300.0
    while not process.poll():
        assert time.monotonic() < end_s
        time.sleep(0.05)
    with pytest.raises(Exception, match="it took longer than permitted"):
        process.report()
    process.close()
