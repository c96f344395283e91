"""Who holds a serial port, as far as the kernel tells this user.

What to use when: `lock_holder` costs one small file and is true for every program that
locks its port, as all of this project do; `open_holders` finds programs that only have it
open, but only those of the same user, or all of them for root.
"""

import contextlib
import os
from dataclasses import dataclass
from pathlib import Path

PROC = Path("/proc")


@dataclass(frozen=True, slots=True)
class Holder:
    """A process that has a port."""

    pid: int
    name: str
    is_ours: bool  # a program of this project: the daemon, or its acquisition process

    def __str__(self) -> str:
        """Say it as a person would: `process 4711, minicom`."""
        return f"process {self.pid}, {self.name}"


def lock_holder(port: str, proc: Path = PROC) -> Holder | None:
    """Return which process has locked `port`, None where that cannot be seen."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        inode = str(Path(port).stat().st_ino)
        for line in (proc / "locks").read_text(encoding="ascii").splitlines():
            words = line.split()  # 1: FLOCK ADVISORY WRITE 4711 00:05:88 0 EOF
            if words[1] == "FLOCK" and words[5].split(":")[2] == inode:
                return _holder(proc / words[4])
    return None


def open_holders(port: str, proc: Path = PROC) -> list[Holder]:
    """Return the processes, but this one, that have `port` open, whether locked or not."""
    try:
        wanted = Path(port).stat().st_rdev
    except OSError:
        return []
    found: list[Holder] = []
    for folder in proc.iterdir():
        if not folder.name.isdecimal() or int(folder.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):  # it ended, or is another user's
            if any(_is_device(fd, wanted) for fd in (folder / "fd").iterdir()):
                found.append(_holder(folder))
    return found


def _is_device(fd: Path, wanted: int) -> bool:
    # the link's text first: a stat of every socket and pipe of the machine is slow
    with contextlib.suppress(OSError):
        return str(fd.readlink()).startswith("/dev/") and fd.stat().st_rdev == wanted
    return False


def _holder(folder: Path) -> Holder:
    name = (folder / "comm").read_text(encoding="utf-8", errors="replace").strip()
    command = (folder / "cmdline").read_bytes().split(b"\0")
    return Holder(int(folder.name), name, any(b"gyrorig" in word for word in command[:4]))
