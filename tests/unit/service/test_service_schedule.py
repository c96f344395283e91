"""When the entries of a schedule are due, also if the system time changes."""

import json
from pathlib import Path

import pytest

from gyrorig_daemon.config import parse_rig
from gyrorig_daemon.config.service_settings import ScheduleEntry
from gyrorig_daemon.service.schedule import Schedule
from gyrorig_protocol.errors import UsageError

DAY_S = 86_400.0
MIDNIGHT_S = 20_700 * DAY_S
NIGHTLY = ScheduleEntry(name="nightly", program="p.yaml", at_utc="02:30")
HOURLY = ScheduleEntry(name="hourly", program="p.yaml", every_h=1.0)
AT_S = 2.5 * 3600.0


class Days:
    """A schedule, a monotonic clock, and a wall clock that can be set."""

    def __init__(self, folder: Path, *entries: ScheduleEntry, utc_s: float = MIDNIGHT_S) -> None:
        self.state = folder / "schedule.json"
        self.entries = entries
        self.now_s, self.utc_s = 100.0, utc_s
        self.restart()

    def restart(self, monotonic_s: float = 100.0) -> None:
        self.now_s = monotonic_s
        self.schedule = Schedule(self.entries, self.state, self.now_s)

    def pass_time(self, seconds: float, step_s: float = 60.0) -> list[float]:
        """Let time pass; return the wall clock's times at which something was begun."""
        begun = []
        for _ in range(int(seconds / step_s)):
            self.now_s += step_s
            self.utc_s += step_s
            entry = self.schedule.due_entry(self.now_s, self.utc_s)
            if entry is not None:
                self.schedule.record_start(entry.name, self.now_s, self.utc_s)
                begun.append(self.utc_s - MIDNIGHT_S)
        return begun


def test_daily(tmp_path: Path) -> None:
    days = Days(tmp_path, NIGHTLY)
    assert days.pass_time(3 * DAY_S) == [AT_S, DAY_S + AT_S, 2 * DAY_S + AT_S]
    assert days.schedule.seconds_until_due(NIGHTLY, days.now_s, days.utc_s) == AT_S


def test_a_restart_does_not_repeat_the_days_session(tmp_path: Path) -> None:
    days = Days(tmp_path, NIGHTLY)
    assert len(days.pass_time(AT_S + 600.0)) == 1
    days.restart()
    assert days.pass_time(DAY_S - 3600.0) == []


def test_what_could_not_begin_is_tried_again(tmp_path: Path) -> None:
    days = Days(tmp_path, NIGHTLY, HOURLY)
    tried: list[tuple[str, float]] = []
    for _ in range(int(2 * DAY_S / 10.0)):
        days.now_s += 10.0
        days.utc_s += 10.0
        entry = days.schedule.due_entry(days.now_s, days.utc_s)
        if entry is not None:
            at_s = days.utc_s - MIDNIGHT_S
            days.schedule.record_start(entry.name, days.now_s, days.utc_s)
            tried.append((entry.name, at_s))
            if entry is NIGHTLY and at_s < DAY_S:
                wait_s = days.schedule.postpone(entry.name, days.now_s)
                assert wait_s is not None
                next_s = days.schedule.seconds_until_due(NIGHTLY, days.now_s, days.utc_s)
                assert next_s == pytest.approx(wait_s)
    hourly = [at_s for name, at_s in tried if name == "hourly"]
    assert len(hourly) == 48  # one that cannot begin keeps no other from it
    nightly = [at_s - AT_S for name, at_s in tried if name == "nightly"]
    assert nightly[:5] == [0.0, 30.0, 90.0, 210.0, 450.0]
    assert nightly[-2] <= 3600.0  # until it is too late for the day
    assert nightly[-1] == DAY_S  # and the next day's is one of its own


def test_what_could_not_begin_is_due_after_a_restart(tmp_path: Path) -> None:
    days = Days(tmp_path, NIGHTLY)
    assert days.pass_time(AT_S + 60.0) == [AT_S]
    days.schedule.postpone("nightly", days.now_s)
    days.restart()
    assert days.pass_time(600.0) == [AT_S + 120.0]
    assert days.schedule.postpone("of another configuration", days.now_s) is None


def test_switched_on_a_little_late_and_too_late(tmp_path: Path) -> None:
    days = Days(tmp_path, NIGHTLY, utc_s=MIDNIGHT_S + AT_S + 1800.0)
    assert days.pass_time(600.0) == [AT_S + 1860.0]
    other = Days(tmp_path / "other", NIGHTLY, utc_s=MIDNIGHT_S + AT_S + 3700.0)
    assert other.pass_time(3600.0) == []


def test_a_clock_that_is_set_back_over_the_time_begins_it_once(tmp_path: Path) -> None:
    days = Days(tmp_path, NIGHTLY)
    assert len(days.pass_time(AT_S + 600.0)) == 1
    days.utc_s -= 1800.0
    assert days.pass_time(7200.0) == []
    days.restart()
    days.utc_s -= 7200.0
    assert days.pass_time(7200.0) == []


def test_a_clock_that_was_years_ahead_does_not_stop_it_for_years(tmp_path: Path) -> None:
    days = Days(tmp_path, NIGHTLY, utc_s=MIDNIGHT_S + 4000 * DAY_S)
    assert len(days.pass_time(DAY_S)) == 1
    days.utc_s = MIDNIGHT_S + DAY_S
    assert days.pass_time(DAY_S) == [DAY_S + AT_S]
    days.restart()
    assert days.pass_time(DAY_S) == [2 * DAY_S + AT_S]


def test_every_hour_whatever_the_wall_clock_does(tmp_path: Path) -> None:
    days = Days(tmp_path, HOURLY)
    assert len(days.pass_time(3600.0)) == 1  # at once, as it never was before
    days.utc_s += 9e7
    assert len(days.pass_time(3600.0)) == 1
    days.utc_s -= 9e8
    assert len(days.pass_time(7200.0)) == 2


def test_what_passed_before_a_restart_counts_where_it_makes_sense(tmp_path: Path) -> None:
    days = Days(tmp_path, HOURLY)
    days.pass_time(120.0)
    days.utc_s += 1800.0  # half an hour without a daemon
    days.restart()
    assert days.pass_time(1500.0) == []
    assert len(days.pass_time(600.0)) == 1
    days.restart()
    days.utc_s -= 9e8
    assert days.pass_time(3540.0) == []
    assert len(days.pass_time(120.0)) == 1


@pytest.mark.parametrize("held", [b"", b"[1]", b'{"nightly": "x"}', b"\xff", b"[" * 5000])
def test_a_broken_memory_is_none(tmp_path: Path, held: bytes) -> None:
    (tmp_path / "schedule.json").write_bytes(held)
    days = Days(tmp_path, NIGHTLY)
    assert len(days.pass_time(DAY_S)) == 1
    assert list(json.loads(days.state.read_text())) == ["nightly"]


def test_the_longest_waiting_goes_first_and_a_disk_that_refuses_is_lived_with(
    tmp_path: Path,
) -> None:
    days = Days(tmp_path / "no" / "folder", HOURLY, NIGHTLY, utc_s=MIDNIGHT_S + AT_S - 60.0)
    begun = days.pass_time(7200.0)
    assert begun == [AT_S, AT_S + 60.0, AT_S + 3600.0]  # hourly, nightly, hourly again


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        (
            "{name: a, program: p}",
            "in the schedule, the entry a has no time. Give the entry either",
        ),
        (
            '{name: a, program: p, every_h: 1.0, at_utc: "01:00"}',
            "the entry a has two times",
        ),
        ('{name: a, program: p, at_utc: "25:00"}', "is not a time of day"),
        ("{name: ../a, program: p, every_h: 1.0}", "is not a valid name of an entry"),
        (
            "{name: a, program: p, every_h: 1.0}, {name: a, program: p, every_h: 2.0}",
            "two entries with the name a",
        ),
        ("{name: a, program: p, every_h: 0.0}", "schedule"),
    ],
)
def test_schedules_that_cannot_be_kept(entry: str, words: str) -> None:
    text = (
        "rig: r\nptu: {port: emulated}\nboards: [{id: B, port: emulated, baud: 460800}]\n"
        f"schedule: [{entry}]\n"
    )
    with pytest.raises(UsageError, match=words):
        parse_rig(text, "rig.yaml")
