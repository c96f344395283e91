"""The state file during and after a fault: what a power cut at that moment leaves."""

import errno
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.unit.service.test_service_loop import FAR, LIMIT, say

from gyrorig_daemon.config.service_settings import ScheduleEntry
from gyrorig_daemon.service import state_file
from gyrorig_daemon.service.metrics import to_prometheus_text
from gyrorig_daemon.service.schedule import Schedule
from gyrorig_daemon.service.status_screen import render_status
from gyrorig_daemon.session.session import Session
from gyrorig_protocol.atomic_files import write_atomically

Make = Callable[..., Any]


def _refuse(*_: object, **__: object) -> bool:
    raise OSError(errno.ENOSPC, "No space left on device")


def read_state(bench: Any) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(bench.state.persistent_state.read_text())
    return document


def test_a_limit_is_stored_with_its_lock_during_the_aftermath(make_bench: Make) -> None:
    bench = make_bench()
    states: list[dict[str, Any]] = []
    writes: list[dict[str, Any]] = []
    write = bench.parts.persistent._write

    def write_and_note() -> None:
        write()
        writes.append(read_state(bench))

    bench.parts.persistent._write = write_and_note
    bench.put(FAR)
    bench.at(5.0, say(bench, LIMIT))
    bench.at(14.0, lambda: states.append(read_state(bench)))
    bench.at(14.0, lambda: states.append(bench.statuses[-1]))
    bench.at(20.0, bench.orders.clear.set)
    bench.serve(30.0)
    stored, status = states
    assert status["reason"].endswith("the recording continues")
    assert "reached a limit" in stored["hold"]["reason"]
    assert stored["steps_are_sure"] is False
    assert writes[0] == stored  # one write: no power cut separates the two values


@pytest.mark.parametrize("request_name", ["request_halt", "request_termination"])
def test_a_stop_stores_its_state_before_the_recording_closes(
    make_bench: Make, monkeypatch: pytest.MonkeyPatch, request_name: str
) -> None:
    bench = make_bench()
    states: list[dict[str, Any]] = []
    close = Session.close_partial

    def note_and_close(session: Session) -> list[str]:
        states.append(read_state(bench))
        return close(session)

    def stop() -> None:
        say(bench, LIMIT)()
        getattr(bench.orders, request_name)("user 0")

    monkeypatch.setattr(Session, "close_partial", note_and_close)
    bench.put(FAR)
    bench.at(6.0, stop)
    bench.serve(12.0)
    (stored,) = states
    assert (stored["hold"] is not None) == (request_name == "request_halt")
    assert stored["steps_are_sure"] is False


def test_a_lock_that_a_full_disk_refused_is_written_later(
    make_bench: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = make_bench()
    set_writer = partial(monkeypatch.setattr, state_file, "write_atomically")

    def set_full(is_full: bool) -> Callable[[], None]:
        writer = _refuse if is_full else write_atomically
        return lambda: set_writer(writer)

    bench.at(4.0, set_full(True))
    bench.at(5.0, lambda: bench.orders.request_halt("user 0"))
    bench.at(10.0, set_full(False))
    bench.serve(14.0)
    assert read_state(bench)["hold"]["reason"].endswith("halt (user 0)")
    failures = bench.statuses[-1]["counts"]["state_write_failures"]
    assert 5 <= failures <= 7  # one per second
    assert f"gyrorig_state_write_failures_total {failures}\n" in to_prometheus_text(
        bench.statuses[-1]
    )
    assert f"state files not written {failures}" in render_status(bench.statuses[-1])


def test_a_start_that_a_full_disk_refused_is_written_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry = ScheduleEntry(name="nightly", program="p.yaml", at_utc="02:00")
    path, monotonic_s, utc_s = tmp_path / "schedule.json", 10.0, 20_000 * 86_400.0 + 7_201.0
    schedule = Schedule([entry], path, 0.0)
    with monkeypatch.context() as full_disk:
        full_disk.setattr(state_file, "write_atomically", _refuse)
        schedule.record_start("nightly", monotonic_s, utc_s)
    assert not path.exists()
    schedule.file.write_pending()
    assert Schedule([entry], path, 100.0).due_entry(110.0, utc_s + 1_200.0) is None
