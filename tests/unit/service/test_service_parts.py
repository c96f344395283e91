"""Readiness, watchdog, locks, whole files, the wall clock, the metrics: each on its own."""

import os
import re
import socket
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gyrorig_daemon.links.capture_clock import HostClocks
from gyrorig_daemon.service.files import write_whole
from gyrorig_daemon.service.keeping import Account
from gyrorig_daemon.service.memory import Hold, Memory
from gyrorig_daemon.service.metrics import MetricsWriter, exposition
from gyrorig_daemon.service.notify import Notifier
from gyrorig_daemon.service.orders import Orders
from gyrorig_daemon.service.state import StateFolder
from gyrorig_daemon.service.wall_clock import WallClockTimer
from gyrorig_daemon.service.watch import losses, picture
from gyrorig_daemon.service.watchdog import Pulse, WatchdogTimer
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
        notifier = Notifier.from_environment(environment)
        assert environment == {}  # children are not to speak
        assert notifier.watchdog_s == 10.0
        notifier.ready()
        notifier.alive()
        notifier.status("waiting:\nfor\x20 it")
        notifier.stopping()
        said = [systemd.recv(500).decode() for _ in range(4)]
        assert said == ["READY=1", "WATCHDOG=1", "STATUS=waiting: for it", "STOPPING=1"]
        notifier.reloading()
        assert systemd.recv(500).startswith(b"RELOADING=1\nMONOTONIC_USEC=")
    notifier.alive()  # nobody listens any more: no fault
    notifier.close()
    notifier.alive()


def test_an_abstract_address_and_somebody_elses_watchdog() -> None:
    name = f"gyrorig-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind("\0" + name)
        systemd.settimeout(60.0)
        environment = {"NOTIFY_SOCKET": f"@{name}", "WATCHDOG_USEC": "5", "WATCHDOG_PID": "1"}
        notifier = Notifier.from_environment(environment)
        assert notifier.watchdog_s is None
        notifier.ready()
        assert systemd.recv(100) == b"READY=1"
        notifier.close()
    Notifier.from_environment({}).ready()


class Spoken(Notifier):
    def __init__(self) -> None:
        super().__init__(None, 8.0)
        self.fed = 0

    def alive(self) -> None:
        self.fed += 1


def test_the_watchdog_is_fed_only_when_every_loop_made_progress() -> None:
    now_ns = 0
    pulse = Pulse("socket", 3.0, lambda: now_ns)
    notifier, told = Spoken(), list[str]()
    timer = WatchdogTimer(
        notifier, lambda: [pulse.name] if pulse.hangs else [], now_ns, told.append
    )
    for second in range(20):
        now_ns = second * 1_000_000_000
        if second < 5 or second > 14:
            pulse.beat()
        if now_ns >= timer.due_ns:
            timer.fire(now_ns)
    # every 2 s: 0 to 6 (the loop stops at 4 and may take 3), then from 16 on
    assert notifier.fed == 4 + 2
    assert told == ["no progress in socket: the watchdog is not fed"]


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
    write_whole(path, b"first", 0o600)
    write_whole(path, b"second", 0o600)
    assert path.read_bytes() == b"second"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert [p.name for p in tmp_path.iterdir()] == ["f"]
    with pytest.raises(OSError, match="No such file"):
        write_whole(tmp_path / "none" / "f", b"")


def test_a_hold_and_a_doubt_are_remembered(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    memory = Memory(path, 1.0)
    assert (memory.hold, memory.steps_are_sure) == (None, True)
    assert not path.exists()
    memory.hold = Hold("it met its limit", 5.0)
    memory.steps_are_sure = False
    again = Memory(path, 9.0)
    assert (again.hold, again.steps_are_sure) == (Hold("it met its limit", 5.0), False)
    again.hold, again.steps_are_sure = None, True
    assert Memory(path, 9.0).hold is None
    for broken in (b"", b"{}", b"[", b'{"hold": 3, "steps_are_sure": true}', b"[" * 9999):
        path.write_bytes(broken)
        held = Memory(path, 9.0)
        assert held.hold is not None, broken
        assert not held.steps_are_sure
    lost = Memory(tmp_path / "none" / "rig.json", 1.0)
    lost.hold = Hold("x", 1.0)
    assert (lost.hold, lost.failures) == (Hold("x", 1.0), 1)


def test_steps_of_the_wall_clock_are_told_from_slews() -> None:
    steps: list[float] = []
    raw_ns, real_ns = 0, 1_790_000_000_000_000_000

    def read() -> HostClocks:
        return HostClocks(raw_ns, raw_ns, real_ns, 500.0, 0.0, 0x40)

    timer = WallClockTimer(read, 0, steps.append)
    assert timer.synchronised is None
    for second in range(100):
        raw_ns += 1_000_000_000
        real_ns += 1_000_500_000  # 500 ppm, the fastest slew there is
        if second == 50:
            real_ns -= 3_600_000_000_000
        timer.fire(raw_ns)
    assert steps == [pytest.approx(-3600.0, abs=0.01)]
    assert timer.synchronised is False


def test_orders_outlive_what_they_interrupt() -> None:
    orders = Orders()
    orders.ask_to_halt("me")
    assert not orders.heard()
    assert orders.stop.reason is None
    orders.ask_to_end("SIGTERM")
    orders.ask_to_halt("me")
    assert orders.heard()
    assert orders.stop.reason is not None


def test_accounts_of_recorders_add_up() -> None:
    account = Account()
    account.close({"written": 5, "queue_high_water": 9, "memory_bytes": 3})
    account.close({"written": 2, "queue_high_water": 4, "memory_bytes": 1})
    assert account.total(None) == {"written": 7, "queue_high_water": 9}
    now = account.total({"written": 1, "queue_high_water": 20, "memory_bytes": 8})
    assert now == {"written": 8, "queue_high_water": 20, "memory_bytes": 8}


def test_the_metrics_are_what_prometheus_reads(make_bench: Make, tmp_path: Path) -> None:
    bench = make_bench()
    bench.put()
    bench.serve(8.0)
    text = exposition(bench.statuses[-1])
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


def test_a_disk_that_refuses_metrics_is_counted(make_bench: Make, tmp_path: Path) -> None:
    bench = make_bench()
    bench.serve(2.0)
    folder = tmp_path / "metrics"
    writer = MetricsWriter(folder, every=1)  # it makes its folder
    folder.rmdir()
    folder.touch()  # root writes to any folder
    writer.publish(bench.statuses[-1])
    assert writer.settle(60.0)
    assert writer.failures == 1
    folder.unlink()
    writer.publish(bench.statuses[-1])
    writer.close()  # what it was given is written first
    assert writer.failures == 1
    assert writer.path.read_text() == exposition(bench.statuses[-1])


def test_metrics_that_have_no_place(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(MachineError, match="no metrics can be written") as caught:
        MetricsWriter(tmp_path / "file")
    assert "--metrics" in caught.value.remedy


def test_a_person_can_read_it(make_bench: Make) -> None:
    bench = make_bench()
    bench.put()
    bench.serve(12.0)
    running = picture(bench.state_at(5.0))
    assert running.startswith("rig test: running\n")
    assert "] step " in running
    assert " of 3, " in running
    assert " left\n" in running
    assert ", pan +" in running
    assert " ms late, " in running
    assert "lost  nothing" in running
    assert "board B-1  sends samples, " in running
    after = picture(bench.state_at(11.0))
    assert re.search(r", clock [+-]\d+\.\d ppm ± \d+ us\n", after)
    assert ", says where within " in after
    assert "queue  empty" in after
    assert "done" in after
    bad = bench.state_at(11.0)
    bad["boards"][0]["counts"]["missing"] = 7
    bad["recorder"]["counts"]["dropped_queue_full"] = 3
    assert losses(bad) == {"B-1 missing samples": 7, "messages dropped queue full": 3}
