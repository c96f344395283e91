"""The service with a system time that no recording can hold."""

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import pytest

from gyrorig_daemon.recorder.sequence_numbers import SequenceNumbers
from gyrorig_daemon.service.service_loop import LoopExit
from gyrorig_daemon.service.system_clock_monitor import clock_problem

Make = Callable[..., Any]


@pytest.mark.parametrize("year", [1969, 2039, 2105])
def test_no_session_begins_until_the_clock_is_set(make_bench: Make, year: int) -> None:
    bench = make_bench()
    wrong_s = datetime(year, 6, 1, tzinfo=UTC).timestamp()
    bench.stepped_s = wrong_s - bench.utc_s()
    bench.put()
    bench.at(10.0, lambda: setattr(bench, "stepped_s", 0.0))
    assert bench.serve(60.0, bench.ended("done", 1)) is LoopExit.END
    before = bench.state_at(8.0)
    assert before["state"] == "waiting"
    assert before["reason"].startswith(f"the system time is {year}-")
    assert len(bench.recordings()) == 1
    assert bench.parts.counts.sessions_failed == 0


def test_the_limits_of_the_clock() -> None:
    assert clock_problem(0.0) == clock_problem(2.1e9) == ""
    assert "2038-01-12" in clock_problem(2.0**31 - 86_400)
    assert "1969-12-31" in clock_problem(-1.0)


def test_a_session_whose_messages_are_refused_has_failed(
    make_bench: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> None:
        raise ValueError("the time does not fit")

    bench = make_bench()
    bench.put()
    monkeypatch.setattr(SequenceNumbers, "make_record", refuse)
    assert bench.serve(60.0, bench.ended("failed", 1)) is LoopExit.END
    (result,) = bench.results("failed")
    assert "Check the clock of the computer" in result.read_text()
    assert bench.parts.counts.sessions_done == 0
