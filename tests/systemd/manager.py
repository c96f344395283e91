"""A service manager of its own: `systemd --user` in a process namespace, without PID 1.

What to use when: `Manager` in tests of readiness, watchdog, restart and stop order (level 1).
It needs root and unshare; nothing of it is seen outside, and all of it ends with the test.
"""

import os
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

SYSTEMD = Path("/lib/systemd/systemd")
UNSHARE = ("unshare", "--mount", "--pid", "--fork", "--mount-proc")
# What only a system manager can do, and the sandbox: tested at level 2.
SYSTEM_ONLY = (
    "User", "Group", "SupplementaryGroups", "OOMScoreAdjust", "Device", "DevicePolicy", "Protect",
    "Private", "Proc", "NoNewPrivileges", "Restrict=", "RestrictS", "RestrictR", "RestrictN",
    "RestrictA", "LockPersonality", "MemoryDeny", "Capability", "Ambient", "SystemCall",
    "IPAddress", "RemoveIPC", "Nice", "CPUScheduling", "IOScheduling", "MemoryMax",
)  # fmt: skip
_SETUP = """
mount -t tmpfs tmpfs /run || exit 9
mkdir -p /run/systemd/system /run/user/0
{systemd} --user >/dev/null 2>&1 &
"""


def why_not() -> str:
    """Return why there can be no such manager here, "" where there can."""
    if not SYSTEMD.exists():
        return "no systemd here: it comes with the package systemd"
    if os.geteuid() != 0:
        return "a manager of one's own needs root (unshare --mount --pid)"
    if shutil.which("unshare") is None:
        return "no unshare here: it comes with the package util-linux"
    tried = subprocess.run(
        [*UNSHARE, "mount", "-t", "tmpfs", "t", "/run"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    return "" if tried.returncode == 0 else f"unshare is not allowed here: {tried.stderr.strip()}"


def for_a_user(text: str, prefix: Path, config: Path) -> str:
    """Return a unit of systemd/ as a user's manager can run it."""
    lines = [line for line in text.splitlines() if not line.startswith(SYSTEM_ONLY)]
    text = "\n".join(lines).replace("/var/lib/gyrorig", "%S/gyrorig") + "\n"
    return text.replace("/opt/gyrorig", str(prefix)).replace("/etc/gyrorig/rig.yaml", str(config))


class Manager:
    """A running `systemd --user`; a context."""

    def __init__(self, folder: Path) -> None:
        """Prepare it; units go into `units` before it begins."""
        self.folder = folder
        self.log = folder / "daemon.log"  # where a drop-in lets the units write
        self.units = folder / "config" / "systemd" / "user"
        self.units.mkdir(parents=True)
        self._shell: subprocess.Popen[str] | None = None

    def __enter__(self) -> "Manager":
        """Begin; returns when it answers."""
        environment = {
            key: os.environ[key] for key in ("PATH", "HOME", "LANG") if key in os.environ
        }
        environment |= {
            "XDG_RUNTIME_DIR": "/run/user/0",
            "XDG_CONFIG_HOME": str(self.folder / "config"),
            "XDG_STATE_HOME": str(self.folder / "state"),
            "XDG_DATA_HOME": str(self.folder / "data"),
            "SYSTEMD_PAGER": "",
        }
        self._shell = subprocess.Popen(
            [*UNSHARE, "--kill-child", "bash"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, env=environment,
        )  # fmt: skip
        if self._shell.stdin is None:
            raise AssertionError
        self._shell.stdin.write(_SETUP.format(systemd=SYSTEMD))
        self.until(lambda: "running" in self.say("systemctl --user is-system-running"))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End it and everything that it has started."""
        if self._shell is not None:
            self._shell.kill()  # unshare's --kill-child does the rest
            self._shell.wait()
            for pipe in (self._shell.stdin, self._shell.stdout):
                if pipe is not None:
                    pipe.close()

    def say(self, command: str) -> str:
        """Run a shell command beside the manager and return its output."""
        if self._shell is None or self._shell.stdin is None or self._shell.stdout is None:
            raise AssertionError
        mark = f"--{time.monotonic_ns()}--"
        self._shell.stdin.write(f"{command} </dev/null 2>&1\necho\necho {mark}\n")
        self._shell.stdin.flush()
        lines = []
        while (line := self._shell.stdout.readline()) and mark not in line:
            lines.append(line)
        return "".join(lines).strip()

    def show(self, unit: str, *names: str) -> dict[str, str]:
        """Return properties of a unit."""
        text = self.say(f"systemctl --user show {unit} -p {','.join(names)}")
        return dict(line.split("=", 1) for line in text.splitlines() if "=" in line)

    def until(self, holds: Callable[[], bool], limit_s: float = 60.0) -> None:
        """Wait for a condition; raises with the units' log when it does not come."""
        end_s = time.monotonic() + limit_s
        while not holds():
            if time.monotonic() > end_s:
                log = self.log.read_text(errors="replace") if self.log.exists() else ""
                raise AssertionError(f"waited {limit_s:g} s in vain; the log ends:\n{log[-3000:]}")
            time.sleep(0.05)
