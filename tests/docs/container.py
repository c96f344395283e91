"""Boot a container with systemd and an emulated rig, for pages that need root and a unit.

What to use when: `RigContainer` is a context manager. Its `prefix` runs a command in the
container. systemd-nspawn boots an overlay of the root folder of this computer and does not write
to that folder. In the container, the ports of config/rig-raspberrypi.yaml are links to the ptys of
`gyrorigd emulate`. The container uses the network of this computer, because the pages install
packages from an index.
"""

import contextlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from gyrorig_daemon.config import load_rig

ROOT = Path(__file__).resolve().parents[2]
CHECKOUT = Path("/root/gyrorig")  # in the container
START_TIMEOUT_S = 180.0
STOP_TIMEOUT_S = 30.0
SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"  # as sudo sets it
_BOOT_SCRIPT = """
set -e
mount -t tmpfs tmpfs {work}
mkdir {work}/up {work}/wk {work}/m
mount -t overlay overlay -o lowerdir=/,upperdir={work}/up,workdir={work}/wk {work}/m
cd {work}/m
rm -rf etc/machine-id opt/gyrorig etc/gyrorig var/lib/gyrorig usr/local/bin/gyrorig{{,d}}
rm -f etc/systemd/system/gyrorig* etc/systemd/system/*.wants/gyrorig*
mkdir -p .{checkout}
echo 'pi:x:1999:1999::/root:/bin/bash' >>etc/passwd
echo 'pi:x:1999:' >>etc/group
exec setpriv --pdeathsig KILL systemd-nspawn -D {work}/m --register=no --keep-unit \
  -M gyrorig-docs -b --console=pipe --resolv-conf=off --bind={clone}:{checkout} {binds} \
  systemd.unit=multi-user.target </dev/null >{log} 2>&1
"""
# Makes the ports that udev would make; they are links to the ptys of the emulator.
_PORTS_SCRIPT = """
set -e
for _ in $(seq 600); do [ -e /run/rig/ptu -a -e /run/rig/board-{board} ] && break; sleep 0.1; done
for pair in ptu={ptu} board-{board}={port}; do
  pty=$(readlink /run/rig/${{pair%%=*}}) name=${{pair#*=}}
  chgrp dialout $pty; chmod 660 $pty
  mkdir -p $(dirname $name); ln -s $pty $name
done
ln -s $(readlink /run/rig/ptu) /dev/ttyUSB0
"""


class ContainerBootError(Exception):
    """The container does not boot, although this computer meets all requirements."""


class RigContainer:
    """A running container."""

    # The commands run as root already, with the path that sudo would set.
    shell = f'sudo() {{ env PATH={SYSTEM_PATH} "$@"; }}\n'

    def __init__(self, folder: Path, clone: Path) -> None:
        """Set the environment of the commands.

        Args:
            folder: an empty folder for the overlay and the console log.
            clone: a clone of the checkout, the working folder of the user.
        """
        self._folder = folder
        self._clone = clone
        self._processes: list[subprocess.Popen[bytes]] = []
        self.checkout = CHECKOUT
        self.prefix: tuple[str, ...] = ()
        environment = {name: value for name, value in os.environ.items() if name != "TMPDIR"}
        self.environment = {
            **environment,
            "HOME": "/root",
            "USER": "pi",
            "OPENBLAS_NUM_THREADS": "1",
            "PATH": f"{Path(sys.executable).parent}:{SYSTEM_PATH}",
        }

    @staticmethod
    def find_missing_requirement() -> str:
        """Return which requirement this computer does not meet, or an empty text."""
        if os.geteuid() != 0:
            return "a container needs root"
        packages = {"systemd-nspawn": "systemd-container", "nsenter": "util-linux"}
        for program, package in packages.items():
            if shutil.which(program) is None:
                return f"{program} is not installed: install the package {package}"
        return ""

    def __enter__(self) -> "RigContainer":
        """Boot the container and connect the emulated rig.

        Raises:
            ContainerBootError: the container does not boot.
            RuntimeError: the emulated rig does not start.
        """
        try:
            self._boot()
            self._connect_rig()
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Shut the container down."""
        self._stop()

    def _boot(self) -> None:
        work = self._folder / "work"
        work.mkdir()
        # Scripts name their interpreter by its path, so these folders keep their paths.
        folders = {ROOT, Path(sys.prefix), Path(sys.base_prefix)}
        binds = [f"--bind-ro={path}" for path in sorted(folders) if not _is_in_usr(path)]
        script = _BOOT_SCRIPT.format(
            work=work,
            clone=self._clone,
            checkout=CHECKOUT,
            log=self._console,
            binds=" ".join(binds),
        )
        container = subprocess.Popen(
            ["unshare", "--mount", "--propagation", "private", "bash", "-c", script]
        )
        self._processes.append(container)
        self._wait_until(lambda: bool(_find_manager_pid(container.pid)))
        self.prefix = (
            "nsenter", "--target", str(_find_manager_pid(container.pid)), "--mount", "--uts",
            "--ipc", "--pid",
        )  # fmt: skip
        self._wait_until(
            lambda: self._run("systemctl", "is-system-running") in ("running", "degraded")
        )

    def _connect_rig(self) -> None:
        config = load_rig(self._clone / "config" / "rig-raspberrypi.yaml")
        (board,) = config.boards
        emulated = self._clone / "emulated.yaml"
        emulated.write_text(
            f"rig: {config.rig}\n"
            f"ptu: {{port: emulated, baud: {config.ptu.baud}}}\n"
            f"boards: [{{id: {board.id}, port: emulated, baud: {board.baud}}}]\n"
            "emulator: {seed: 1, homed: false}\n"
        )
        with self._console.open("ab") as log:
            emulator = subprocess.Popen(
                [*self.prefix, "gyrorigd", "emulate", "--links", "/run/rig", "--config",
                 str(CHECKOUT / emulated.name)],
                env=self.environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
            )  # fmt: skip
        self._processes.append(emulator)
        script = _PORTS_SCRIPT.format(board=board.id, ptu=config.ptu.port, port=board.port)
        output = self._run("bash", "-c", script)
        if output or emulator.poll() is not None:
            raise RuntimeError(f"the emulated rig does not start: {output} {self._read_console()}")

    @property
    def _console(self) -> Path:
        return self._folder / "console.txt"

    def _read_console(self) -> str:
        """Return the last lines of the console."""
        text = self._console.read_text(errors="replace") if self._console.exists() else ""
        return str(text.strip().splitlines()[-5:])

    def _run(self, *line: str) -> str:
        """Run a command in the container, and return its output."""
        process = subprocess.run(
            [*self.prefix, *line], env=self.environment, stdin=subprocess.DEVNULL,
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        return (process.stdout + process.stderr).strip()

    def _wait_until(self, is_true: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + START_TIMEOUT_S
        while not is_true():
            if self._processes[0].poll() is not None or time.monotonic() > deadline_s:
                raise ContainerBootError(f"the container does not boot: {self._read_console()}")
            time.sleep(0.1)

    def _stop(self) -> None:
        for process in reversed(self._processes):  # the container shuts down on SIGTERM
            process.terminate()
            try:
                process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._processes = []
        # With --keep-unit, the control groups of the container remain.
        for name in ("payload", "supervisor", "init.scope"):
            for path in sorted(Path("/sys/fs/cgroup").glob(f"**/{name}*"), reverse=True):
                with contextlib.suppress(OSError):
                    path.rmdir()


def _is_in_usr(path: Path) -> bool:
    return path.is_relative_to("/usr")


def _find_manager_pid(pid: int) -> int:
    """Return the first process of the container, or 0 if systemd-nspawn has not started it."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        names = {int(child): Path(f"/proc/{child}/comm").read_text().strip() for child in children}
    except OSError:
        return 0
    return next((child for child, name in names.items() if name == "systemd"), 0)
