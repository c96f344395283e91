"""Readiness, watchdog, locks, atomic files, system time and metrics, one by one."""

import os
import re
import socket
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gyrorig_daemon.clocks.capture_clock import HostClocks
from gyrorig_daemon.service.metrics import MetricsWriter, to_prometheus_text
from gyrorig_daemon.service.persistent_state import MotionLock, PersistentState
from gyrorig_daemon.service.recording_policy import RecorderTotals
from gyrorig_daemon.service.service_context import OperatorRequests
from gyrorig_daemon.service.state_folder import StateFolder
from gyrorig_daemon.service.status_screen import count_losses, render_status
from gyrorig_daemon.service.system_clock_monitor import SystemClockMonitor
from gyrorig_daemon.service.systemd_notifier import SystemdNotifier
from gyrorig_daemon.service.watchdog import Heartbeat, WatchdogTimer
from gyrorig_protocol.atomic_files import write_atomically
from gyrorig_protocol.errors import BusyError, MachineError

Make = Callable[..., Any]


def test_what_systemd_is_told(tmp_path: Path) -> None:
    path = tmp_path / "n"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(path))
        systemd.settimeout(60.0)
        environment = {
            "NOTIFY_SOCKET": str(path),
            "WATCHDOG_USEC": "10000000",
            "WATCHDOG_PID": str(os.getpid()),
        }
        notifier = SystemdNotifier.from_environment(environment)
        assert environment == {}  # children are not to speak
        assert notifier.watchdog_s == 10.0
        notifier.send_ready()
        notifier.feed_watchdog()
        notifier.send_status("waiting:\nfor\x20 it")
        notifier.send_stopping()
        datagrams = [systemd.recv(500).decode() for _ in range(4)]
        assert datagrams == ["READY=1", "WATCHDOG=1", "STATUS=waiting: for it", "STOPPING=1"]
        notifier.send_reloading()
        assert systemd.recv(500).startswith(b"RELOADING=1\nMONOTONIC_USEC=")
    notifier.feed_watchdog()  # nobody listens any more: no fault
    notifier.close()
    notifier.feed_watchdog()


def test_an_abstract_address_and_somebody_elses_watchdog() -> None:
    name = f"gyrorig-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind("\0" + name)
        systemd.settimeout(60.0)
        environment = {"NOTIFY_SOCKET": f"@{name}", "WATCHDOG_USEC": "5", "WATCHDOG_PID": "1"}
        notifier = SystemdNotifier.from_environment(environment)
        assert notifier.watchdog_s is None
        notifier.send_ready()
        assert systemd.recv(100) == b"READY=1"
        notifier.close()
    SystemdNotifier.from_environment({}).send_ready()


class RecordingNotifier(SystemdNotifier):
    def __init__(self) -> None:
        super().__init__(None, 8.0)
        self.fed = 0

    def feed_watchdog(self) -> None:
        self.fed += 1


def test_the_watchdog_is_fed_only_when_every_loop_made_progress() -> None:
    now_ns = 0
    pulse = Heartbeat("socket", 3.0, lambda: now_ns)
    notifier, notices = RecordingNotifier(), list[str]()
    timer = WatchdogTimer(
        notifier, lambda: [pulse.name] if pulse.is_stalled else [], now_ns, notices.append
    )
    for second in range(20):
        now_ns = second * 1_000_000_000
        if second < 5 or second > 14:
            pulse.beat()
        if now_ns >= timer.due_ns:
            timer.fire(now_ns)
    # every 2 s: 0 to 6 (the loop stops at 4 and may take 3), then from 16 on
    assert notifier.fed == 4 + 2
    assert notices == [
        "The daemon makes no progress in socket, so it sends no keep-alive message to systemd."
    ]


def test_one_daemon_a_folder(tmp_path: Path) -> None:
    with StateFolder(tmp_path / "state") as state:
        assert state.recordings.is_dir()
        assert state.free_bytes()
        with pytest.raises(BusyError, match=f"process {os.getpid()}") as caught:
            StateFolder(tmp_path / "state").__enter__()
        assert caught.value.exit_code == 75
    with StateFolder(tmp_path / "state"):
        pass
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(MachineError, match="cannot be used"):
        StateFolder(tmp_path / "file").__enter__()


def test_files_are_whole(tmp_path: Path) -> None:
    path = tmp_path / "f"
    write_atomically(path, b"first", mode=0o600)
    write_atomically(path, b"second", mode=0o600)
    assert path.read_bytes() == b"second"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert [p.name for p in tmp_path.iterdir()] == ["f"]
    with pytest.raises(OSError, match="No such file"):
        write_atomically(tmp_path / "none" / "f", b"")


def test_a_hold_and_a_doubt_are_remembered(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    memory = PersistentState(path, 1.0)
    assert (memory.motion_lock, memory.steps_are_sure) == (None, True)
    assert not path.exists()
    memory.motion_lock = MotionLock("it met its limit", 5.0)
    memory.steps_are_sure = False
    again = PersistentState(path, 9.0)
    assert (again.motion_lock, again.steps_are_sure) == (MotionLock("it met its limit", 5.0), False)
    again.motion_lock, again.steps_are_sure = None, True
    assert PersistentState(path, 9.0).motion_lock is None
    for broken in (b"", b"{}", b"[", b'{"hold": 3, "steps_are_sure": true}', b"[" * 9999):
        path.write_bytes(broken)
        held = PersistentState(path, 9.0)
        assert held.motion_lock is not None, broken
        assert not held.steps_are_sure
    lost = PersistentState(tmp_path / "none" / "rig.json", 1.0)
    lost.motion_lock = MotionLock("x", 1.0)
    assert (lost.motion_lock, lost.file.take_failures()) == (MotionLock("x", 1.0), 1)


def test_steps_of_the_wall_clock_are_told_from_slews() -> None:
    steps: list[float] = []
    raw_ns, real_ns = 0, 1_790_000_000_000_000_000

    def read() -> HostClocks:
        return HostClocks(raw_ns, raw_ns, real_ns, 500.0, 0.0, 0x40)

    timer = SystemClockMonitor(read, 0, steps.append)
    assert timer.is_synchronised is None
    for second in range(100):
        raw_ns += 1_000_000_000
        real_ns += 1_000_500_000  # 500 ppm, the fastest slew there is
        if second == 50:
            real_ns -= 3_600_000_000_000
        timer.fire(raw_ns)
    assert steps == [pytest.approx(-3600.0, abs=0.01)]
    assert timer.is_synchronised is False


def test_orders_outlive_what_they_interrupt() -> None:
    orders = OperatorRequests()
    orders.request_halt("me")
    assert not orders.acknowledge_stop()
    assert orders.stop.reason is None
    orders.request_termination("SIGTERM")
    orders.request_halt("me")
    assert orders.acknowledge_stop()
    assert orders.stop.reason is not None


def test_accounts_of_recorders_add_up() -> None:
    account = RecorderTotals()
    account.add_closed({"written": 5, "queue_high_water": 9, "memory_bytes": 3})
    account.add_closed({"written": 2, "queue_high_water": 4, "memory_bytes": 1})
    assert account.total(None) == {"written": 7, "queue_high_water": 9}
    now = account.total({"written": 1, "queue_high_water": 20, "memory_bytes": 8})
    assert now == {"written": 8, "queue_high_water": 20, "memory_bytes": 8}


def test_the_metrics_are_what_prometheus_reads(make_bench: Make, tmp_path: Path) -> None:
    bench = make_bench()
    bench.put()
    bench.serve(8.0)
    text = to_prometheus_text(bench.statuses[-1])
    seen: set[str] = set()
    typed: dict[str, str] = {}
    for line in text.splitlines():
        if line.startswith("#"):
            _, kind, name, rest = line.split(" ", 3)
            if kind == "TYPE":
                assert name not in typed  # one block a name
                typed[name] = rest
            continue
        key, value = line.rsplit(" ", 1)
        float(value)
        assert key not in seen
        seen.add(key)
        name = key.split("{")[0]
        assert name in typed
        assert (typed[name] == "counter") == name.endswith("_total")
    assert 'gyrorig_board_line_total{board="B-1",cause="missing"}' in seen
    assert "gyrorig_recorder_written_total" in seen
    assert "gyrorig_sessions_done_total" in seen
    writer = MetricsWriter(tmp_path, every=1)
    writer.publish(bench.statuses[-1])
    end = bench.statuses[-1]
    writer.close()
    writer.publish(end)  # after the end: nothing
    assert writer.path.read_text() == text


def test_metrics_have_all_digits(make_bench: Make) -> None:
    bench = make_bench()
    bench.serve(2.0)
    status = bench.statuses[-1]
    status["boards"][0]["counts"]["samples"] = 69_120_049
    status["acquisition_dropped_bytes"] = 12_345_678
    lines = to_prometheus_text(status).splitlines()
    assert 'gyrorig_board_line_total{board="B-1",cause="samples"} 69120049' in lines
    assert "gyrorig_acquisition_dropped_bytes_total 12345678" in lines


def test_a_disk_that_refuses_metrics_is_counted(make_bench: Make, tmp_path: Path) -> None:
    bench = make_bench()
    bench.serve(2.0)
    folder = tmp_path / "metrics"
    writer = MetricsWriter(folder, every=1)  # it makes its folder
    folder.rmdir()
    folder.touch()  # root writes to any folder
    writer.publish(bench.statuses[-1])
    assert writer.wait_until_idle(60.0)
    assert writer.write_failures == 1
    folder.unlink()
    writer.publish(bench.statuses[-1])
    writer.close()  # what it was given is written first
    assert writer.write_failures == 1
    assert writer.path.read_text() == to_prometheus_text(bench.statuses[-1])


def test_metrics_that_have_no_place(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(MachineError, match="the metrics cannot be written") as caught:
        MetricsWriter(tmp_path / "file")
    assert "--metrics" in caught.value.remedy


def test_a_person_can_read_it(make_bench: Make) -> None:
    bench = make_bench()
    bench.put()
    bench.serve(12.0)
    running = render_status(bench.state_at(5.0))
    assert running.startswith("rig test: running\n")
    assert "] step " in running
    assert " of 3, " in running
    assert " left\n" in running
    assert ", pan +" in running
    assert ", latency " in running
    assert "lost  nothing" in running
    assert "board B-1  sends samples, " in running
    after = render_status(bench.state_at(11.0))
    # A member of the group chooses the name of a waiting job.
    hostile = bench.state_at(11.0) | {"queue": {"waiting": 1, "next": ["a\x1b]0;own\x07\udcfc"]}}
    assert "next a\\x1b]0;own\\x07\\udcfc" in render_status(hostile)
    assert re.search(r", clock [+-]\d+\.\d ppm ± \d+ us\n", after)
    assert ", position reply within " in after
    assert "queue  empty" in after
    assert "done" in after
    bad = bench.state_at(11.0)
    bad["boards"][0]["counts"]["missing"] = 7
    bad["recorder"]["counts"]["dropped_queue_full"] = 3
    assert count_losses(bad) == {"B-1 missing samples": 7, "messages dropped queue full": 3}
