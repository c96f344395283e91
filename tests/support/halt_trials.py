"""Ways to block, hang and flood a service; for the tests and the bench of its halts."""

import os
import pty
import select
import shutil
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.support.served_rig import FAR, Devices, Service, wait_for

XOFF, XON = b"\x13", b"\x11"  # Ctrl-S, Ctrl-Q
HANGING_DISK = Path(__file__).with_name("hanging_disk.c")
_FLOOD = """
import os, sys
piece = bytes(range(256)) * 16
while True:
    os.write(int(sys.argv[1]), piece)
"""


@contextmanager
def terminal() -> Iterator[tuple[int, int]]:
    """Yield both ends of a terminal whose output somebody reads."""
    screen, line = pty.openpty()
    ended = threading.Event()

    def read() -> None:
        while not ended.is_set():
            if select.select([screen], [], [], 0.05)[0]:
                os.read(screen, 4096)

    thread = threading.Thread(target=read)
    thread.start()
    try:
        yield screen, line
    finally:
        ended.set()
        thread.join()
        os.close(screen)
        os.close(line)


def prepare_hang(service: Service) -> None:
    """Let the disk of a service hang on demand; before its start."""
    library = service.folder / "hanging_disk.so"
    compiler = shutil.which("cc")
    if compiler is None:
        raise FileNotFoundError("cc")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, HANGING_DISK, "-ldl"], check=True)
    service.environment |= {
        "LD_PRELOAD": str(library),
        "HANG_FILE": str(service.folder / "hang"),
    }


@contextmanager
def hanging_disk(service: Service) -> Iterator[None]:
    """Let the main loop of a service hang in a call of the disk."""
    path = service.folder / "hang"
    path.touch()
    time.sleep(1.5)  # the main loop asks once per second
    try:
        yield
    finally:
        path.unlink()


@contextmanager
def flooding_board(service: Service) -> Iterator[None]:
    """Add a board that sends as fast as its line takes; before the start of the service."""
    screen, line = pty.openpty()
    tty.setraw(line)
    service.add_board("F-1", os.ttyname(line))
    flood = subprocess.Popen([sys.executable, "-c", _FLOOD, str(screen)], pass_fds=[screen])
    try:
        yield
    finally:
        flood.kill()
        flood.wait()
        os.close(screen)
        os.close(line)


@contextmanager
def connections_of_another_user(uid: int, path: Path) -> Iterator[None]:
    """Let another user open more connections to a socket than it may; needs root."""
    script = (
        "import socket, sys, time\n"
        "held = []\n"
        "for _ in range(40):\n"
        "    held.append(socket.socket(socket.AF_UNIX))\n"
        "    held[-1].connect(sys.argv[1])\n"
        "print('held', flush=True)\n"
        "time.sleep(600)\n"
    )
    holder = subprocess.Popen(
        ["/usr/bin/env", "python3", "-c", script, path],
        user=uid,
        group=uid,
        extra_groups=[],
        cwd="/",
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        if holder.stdout is None or holder.stdout.readline() != "held\n":
            raise RuntimeError("the other user could not connect")
        yield
    finally:
        holder.kill()
        holder.communicate()


def make_unit_say(devices: Devices, answer: Callable[[bytes], bytes]) -> None:
    """Replace what the unit says from now on; what it is told still reaches it."""
    line = devices.server._ptys["ptu"]
    write = line.write
    line.write = lambda data: write(answer(data))  # type: ignore[method-assign]


def set_in_motion(service: Service, devices: Devices) -> None:
    """Start a session whose first move takes half a minute."""
    service.enqueue(FAR)
    wait_for(devices.turning)
