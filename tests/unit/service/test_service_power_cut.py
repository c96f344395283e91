"""The state file during and after a fault: what a power cut at that moment leaves."""

import json
from collections.abc import Callable
from typing import Any

import pytest
from tests.unit.service.test_service_loop import FAR, LIMIT, say

from gyrorig_daemon.session.session import Session

Make = Callable[..., Any]


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
