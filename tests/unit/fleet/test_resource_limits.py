"""Deadlines of jobs."""

import time

import pytest

from gyrorig_solver.fleet.jobs import resource_limits
from gyrorig_solver.fleet.jobs.resource_limits import DeadlineExceededError, deadline

LIMIT_S = 30.0  # no wait of these tests takes this long


class _SlowEnd:
    """An object whose removal is still in progress at the deadline."""

    def __del__(self) -> None:
        begin_s = time.monotonic()
        while time.monotonic() - begin_s < LIMIT_S:
            time.sleep(0.001)


def _work(begin_s: float) -> None:
    ends_slowly = _SlowEnd()
    del ends_slowly  # the first alarm ends this, and Python drops its exception
    while time.monotonic() - begin_s < LIMIT_S:
        time.sleep(0.001)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_alarm_that_python_drops_is_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource_limits, "HARD_DEADLINE_FACTOR", 1e4)
    begin_s = time.monotonic()
    with pytest.raises(DeadlineExceededError), deadline(LIMIT_S / 300.0):
        _work(begin_s)
    assert time.monotonic() - begin_s < LIMIT_S
