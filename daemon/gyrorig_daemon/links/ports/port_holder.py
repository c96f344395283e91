"""Which process has a serial port, as far as the kernel shows it to this user.

What to use when: `lock_holder` reads one small file and works for every program that locks
its port, as all programs of this project do. `open_holders` also finds programs that opened
the port without a lock, but only those of the same user, or all of them for root.
"""

import contextlib
import os
from dataclasses import dataclass
from pathlib import Path

PROC = Path("/proc")


@dataclass(frozen=True, slots=True)
class PortHolder:
    """A process that uses a port."""

    pid: int
    name: str
    is_ours: bool  # the daemon or its acquisition process

    def __str__(self) -> str:
        """Return for example `process 4711, minicom`."""
        return f"process {self.pid}, {self.name}"


def lock_holder(port: str, proc: Path = PROC) -> PortHolder | None:
    """Return the process that has locked `port`, None if that is not visible."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        inode = str(Path(port).stat().st_ino)
        for line in (proc / "locks").read_text(encoding="ascii").splitlines():
            words = line.split()  # 1: FLOCK ADVISORY WRITE 4711 00:05:88 0 EOF
            if words[1] == "FLOCK" and words[5].split(":")[2] == inode:
                return _holder(proc / words[4])
    return None


def open_holders(port: str, proc: Path = PROC) -> list[PortHolder]:
    """Return all other processes that have `port` open, locked or not."""
    try:
        device_number = Path(port).stat().st_rdev
    except OSError:
        return []
    holders: list[PortHolder] = []
    for folder in proc.iterdir():
        if not folder.name.isdecimal() or int(folder.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):  # it ended, or belongs to another user
            if any(_is_device(fd, device_number) for fd in (folder / "fd").iterdir()):
                holders.append(_holder(folder))
    return holders


def _is_device(fd: Path, device_number: int) -> bool:
    # Compare the text of the link first: calling stat for every socket and pipe is slow.
    with contextlib.suppress(OSError):
        return str(fd.readlink()).startswith("/dev/") and fd.stat().st_rdev == device_number
    return False


def _holder(folder: Path) -> PortHolder:
    name = (folder / "comm").read_text(encoding="utf-8", errors="replace").strip()
    command = (folder / "cmdline").read_bytes().split(b"\0")
    return PortHolder(int(folder.name), name, any(b"gyrorig" in word for word in command[:4]))
