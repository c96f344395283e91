"""`gyrorigd run` as systemd runs it: a process, signals, a notify socket, emulated devices.

The devices are served by the test, so that their own log tells what the unit was told.
"""

import contextlib
import json
import os
import signal
import socket
import subprocess
import time
from pathlib import Path

import pytest
from tests.support.served_rig import (
    FAR,
    GYRORIGD,
    REST_FAR,
    SHORT,
    Devices,
    Service,
    wait_for,
)
from websocket import create_connection

from gyrorig_daemon.live.foxglove_view import DEFAULT_ADDRESS as LIVE_DEFAULT
from gyrorig_protocol.recording.reader import read_recording


def test_a_life_ended_by_sigterm_in_motion(service: Service, devices: Devices) -> None:
    process = service.start_ready()
    service.enqueue(FAR)
    wait_for(devices.turning)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as never_reads:
        never_reads.connect(str(service.socket))
        never_reads.sendall(b'{"command": "watch"}\n' * 3)
        halts, begun_s = devices.halts(), time.monotonic()
        code, errors = service.end()
    assert code == 0, errors
    assert time.monotonic() - begun_s < 25.0
    assert devices.halts() > halts
    assert not devices.turning()
    (path,) = service.recordings()
    assert read_recording(path).is_complete
    (result,) = service.results("failed")
    assert "SIGTERM. The unit is halted" in result["reason"]
    wait_for(lambda: service.notifications[-1] == "STOPPING=1")
    assert service.notifications.count("WATCHDOG=1") >= 2
    assert not service.socket.exists()
    assert process.poll() == 0
    assert (service.state / "metrics" / "gyrorig.prom").read_text().startswith("# HELP gyrorig_")


def test_killed_with_everything_it_halts_first_when_it_is_started_again(
    service: Service, devices: Devices
) -> None:
    process = service.start_ready()
    service.enqueue(REST_FAR)
    wait_for(devices.turning)
    both = [process.pid, *service.children()]
    for number in (signal.SIGSTOP, signal.SIGKILL):  # neither may see the other's end
        for pid in both:
            os.kill(pid, number)
    process.communicate()
    assert devices.turning()
    halts, begun_s = devices.halts(), time.monotonic()
    service.start()
    wait_for(lambda: not devices.turning())
    assert time.monotonic() - begun_s < 35.0  # of 37.5 s that it would have turned
    assert devices.halts() > halts
    wait_for(lambda: service.notifications.count("READY=1") == 2)
    wait_for(lambda: service.status()["state"] == "ready")
    (result,) = service.results("failed")  # not begun again: it may be what it died of
    assert result["reason"].startswith("The daemon ended while the job was running. Check the rig")
    wait_for(lambda: service.counted("kept", "recovered") == 1)
    (path,) = service.recordings()
    assert len(read_recording(path).array("/board/B-1/imu_raw")) > 10
    assert len(list((service.state / "recordings" / "unclean").glob("*.part"))) == 1
    assert service.end()[0] == 0


def test_crash_after_crash_it_comes_back_and_a_lost_log_does_not_end_it(
    service: Service, devices: Devices
) -> None:
    for _ in range(2):
        process = service.start_ready()
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
    process = service.start_ready()
    assert process.stderr is not None
    process.stderr.close()  # as when the journal restarts
    service.enqueue(SHORT)
    wait_for(lambda: service.results("done"))
    process.terminate()
    assert process.wait(60) == 0


def test_an_acquisition_process_that_hangs_is_replaced(service: Service, devices: Devices) -> None:
    service.start_ready()
    service.enqueue(FAR)
    wait_for(devices.turning)
    (child,) = service.children()
    halts = devices.halts()
    os.kill(child, signal.SIGSTOP)
    wait_for(lambda: not devices.turning())
    assert devices.halts() > halts
    wait_for(lambda: service.status()["state"] == "ready")
    assert service.counted("counts", "acquisition_restarts") == 1
    assert service.children() != [child]
    (result,) = service.results("failed")
    assert "the acquisition process did not respond" in result["reason"]
    assert read_recording(Path(result["recording"])).is_complete
    service.enqueue(SHORT)
    wait_for(lambda: service.results("done"))
    code, errors = service.end()
    assert code == 0
    assert "The ports are opened again" in errors


def listening(pid: int) -> set[tuple[str, int]]:
    """Where a process listens on TCP, as the kernel says: addresses in its own hexadecimal."""
    fds = Path(f"/proc/{pid}/fd")
    addresses, inodes = set(), set()
    for fd in fds.iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed since it was listed
            inodes.add(str(fd.readlink()).removeprefix("socket:[").removesuffix("]"))
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            _, local, _, state, *more = line.split()
            address, _, port = local.partition(":")
            if state == "0A" and more[5] in inodes:  # 0A: it listens
                addresses.add((address, int(port, 16)))
    return addresses


def test_a_live_view_listens_on_the_loopback_alone_and_ends_with_the_daemon(
    service: Service,
) -> None:
    pytest.importorskip("foxglove", reason="no foxglove-sdk: it comes with the extra live")
    assert LIVE_DEFAULT.startswith("127.0.0.1:")  # what --live alone means
    service.more = ["--live", "127.0.0.1:0"]
    process = service.start_ready()
    ((address, port),) = listening(process.pid)
    assert socket.inet_ntoa(int(address, 16).to_bytes(4, "little")) == "127.0.0.1"
    viewer = create_connection(
        f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], timeout=60.0
    )
    assert json.loads(viewer.recv())["name"] == "gyrorigd"
    service.enqueue(SHORT)
    wait_for(lambda: service.results("done"))
    code, errors = service.end()
    viewer.close()
    assert code == 0, errors
    assert f"Live view at ws://127.0.0.1:{port}\n" in errors


def test_an_emulated_rig_that_dies_is_started_again(service: Service) -> None:
    service.config.write_text(
        "rig: system\nptu: {port: emulated}\nboards: [{id: B-1, port: emulated}]\n"
        "service: {reserve_mb: 10, board_patience_s: 0.0}\n"
    )
    service.start_ready()
    wait_for(lambda: service.status()["state"] == "ready")
    children = service.children()
    (emulator,) = [
        pid for pid in children if b"emulate" in Path(f"/proc/{pid}/cmdline").read_bytes()
    ]
    os.kill(emulator, signal.SIGKILL)
    wait_for(lambda: service.counted("counts", "emulator_restarts") == 1)
    wait_for(lambda: service.status()["state"] == "ready")
    assert not set(service.children()) & set(children)
    code, errors = service.end()
    assert code == 0
    assert "The emulated rig has ended (status -9). It is started again." in errors


def test_a_second_daemon_ends_at_once(service: Service, devices: Devices) -> None:
    service.start_ready()
    twin: list[str | Path] = [*GYRORIGD, "run", "--config", service.config]
    cases: list[tuple[list[str | Path], str]] = [
        (["--state", service.state, "--socket", service.folder / "s2"], "another daemon uses"),
        (["--state", service.folder / "x", "--socket", service.socket], "daemon already uses"),
        (["--state", service.folder / "x", "--socket", service.folder / "s2"], "is busy"),
    ]
    for arguments, words in cases:
        ended = subprocess.run([*twin, *arguments], capture_output=True, text=True, check=False)
        assert (ended.returncode, words in ended.stderr) == (75, True), ended.stderr
        assert ended.stderr.count("\n") == 1
    reload_it(service)


def reload_it(service: Service) -> None:
    """The first daemon noticed nothing of the twins; its configuration is read again."""
    assert service.process is not None
    service.config.write_text("rig: [")
    service.process.send_signal(signal.SIGHUP)
    wait_for(lambda: service.counted("counts", "reloads_refused") == 1)
    service.enqueue(SHORT)
    wait_for(lambda: service.results("done"))  # on the old one
    service.config.write_text(service.sane.replace("rig: system", "rig: renamed"))
    service.process.send_signal(signal.SIGHUP)
    wait_for(lambda: service.status().get("rig") == "renamed")
    service.enqueue(SHORT)
    wait_for(lambda: len(service.results("done")) == 2)
    assert [path.name.split("_")[1] for path in service.recordings()] == ["system", "renamed"]
    code, errors = service.end()
    assert code == 0
    assert "was rejected. Reason: rig.yaml is not a YAML document" in errors
