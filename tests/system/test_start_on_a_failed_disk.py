"""A service whose state disk is full or read-only at its start: it halts the unit and waits.

Needs root, to mount a file system; else skipped.
"""

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from tests.support.quick_cases import quick_cases
from tests.support.served_rig import GYRORIGD, Devices, Service, wait_for

from gyrorig_daemon.emulator.pty_server import raw_now_ns


def run(*command: str | Path) -> bool:
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


@pytest.fixture
def state_disk(service: Service) -> Iterator[Path]:
    """A tmpfs of 256 KiB as the state folder of the service."""
    folder = service.state
    folder.mkdir()
    if os.geteuid() != 0 or not run("mount", "-t", "tmpfs", "-o", "size=256k", "no", folder):
        pytest.skip("mounting a file system needs root, and a container that allows it")
    yield folder
    run("umount", "-l", folder)


def fill(folder: Path) -> None:
    """Take all space, also that of the lock file, which other programs can take when it is cut."""
    (folder / "lock").write_bytes(b"")
    with (folder / "ballast").open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(1024))


def test_a_first_start_on_a_read_only_disk_halts_the_unit(
    service: Service, devices: Devices, state_disk: Path
) -> None:
    """The folders of the queue do not exist and cannot be created."""
    assert run("mount", "-o", "remount,ro", state_disk)
    assert devices.rig.ptu is not None
    devices.rig.ptu.receive(b"PS50 PP3000 ", raw_now_ns())
    wait_for(devices.turning)
    process = service.start()
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "cannot be used" in errors
    assert devices.halts() == 1
    wait_for(lambda: not devices.turning(), 10.0)


@pytest.mark.parametrize(
    "fault", quick_cases(["full", "read-only", "read-only without a lock"], ["full", "read-only"])
)
def test_a_start_on_a_failed_disk_halts_the_unit(
    service: Service, devices: Devices, state_disk: Path, fault: str
) -> None:
    service.more = ["--metrics", str(service.folder / "metrics")]
    process = service.start_ready()
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    if fault == "full":
        fill(state_disk)
    else:
        if "without" in fault:
            (state_disk / "lock").unlink()
        wait_for(lambda: run("mount", "-o", "remount,ro", state_disk))
    wait_for(lambda: not devices.turning())
    assert devices.rig.ptu is not None
    devices.rig.ptu.receive(b"PS50 PP3000 ", raw_now_ns())
    wait_for(devices.turning)
    halts = devices.halts()
    service.start_ready()
    wait_for(lambda: not devices.turning(), 10.0)
    assert devices.halts() > halts
    wait_for(lambda: service.status()["state"] == "waiting")
    reason = service.status()["reason"]
    assert ("are free for recordings" if fault == "full" else "is not writable") in reason
    command: list[str | Path] = [*GYRORIGD, "run", "--config", service.config]
    command += ["--state", service.state, "--socket", service.folder / "sock2"]
    second = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
    )
    assert second.returncode == 75, second.stderr
    assert "another daemon uses the state folder" in second.stderr
    assert service.end()[0] == 0
