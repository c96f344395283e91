"""A computer with a rig, for pages that need root and a unit: a container with a service manager.

What to use when: `RigsComputer`, a context; `prefix` brings a command into it. systemd-nspawn
boots an overlay of this computer's own root, of which nothing is written to. In it the ports
that config/rig-raspberrypi.yaml names lead to the ptys of `gyrorigd emulate`. It has this
computer's network, since what a page installs comes from a package index.
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
CHECKOUT = Path("/root/gyrorig")  # inside
STARTED_WITHIN_S = 180.0
ENDED_WITHIN_S = 30.0
SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"  # as sudo's own
_OVERLAY = """
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
# Ports as udev makes them; the emulator's are ptys.
_PORTS = """
set -e
for _ in $(seq 600); do [ -e /run/rig/ptu -a -e /run/rig/board-{board} ] && break; sleep 0.1; done
for pair in ptu={ptu} board-{board}={port}; do
  pty=$(readlink /run/rig/${{pair%%=*}}) name=${{pair#*=}}
  chgrp dialout $pty; chmod 660 $pty
  mkdir -p $(dirname $name); ln -s $pty $name
done
ln -s $(readlink /run/rig/ptu) /dev/ttyUSB0
"""


class DoesNotBootError(Exception):
    """This computer has all that a container needs, and none comes up."""


class RigsComputer:
    """A running container."""

    # Who types is root already, and has what sudo would give.
    shell = f'sudo() {{ env PATH={SYSTEM_PATH} "$@"; }}\n'

    def __init__(self, folder: Path, clone: Path) -> None:
        """Prepare it.

        Args:
            folder: an empty one, for what it writes down.
            clone: of the checkout, for its user to stand in.
        """
        self._folder = folder
        self._clone = clone
        self._running: list[subprocess.Popen[bytes]] = []
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
    def why_not() -> str:
        """Return why there can be no such computer here, "" where there can."""
        if os.geteuid() != 0:
            return "a container needs root"
        packages = {"systemd-nspawn": "systemd-container", "nsenter": "util-linux"}
        for program, package in packages.items():
            if shutil.which(program) is None:
                return f"no {program} here: it comes with the package {package}"
        return ""

    def __enter__(self) -> "RigsComputer":
        """Boot, and plug the rig in.

        Raises:
            DoesNotBootError: it does not come up.
            RuntimeError: the emulated rig does not.
        """
        try:
            self._boot()
            self._plug_in()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Switch it off."""
        self._end()

    def _boot(self) -> None:
        work = self._folder / "work"
        work.mkdir()
        # Programs and packages at the very paths that their first lines name
        held = {ROOT, Path(sys.prefix), Path(sys.base_prefix)}
        binds = [f"--bind-ro={path}" for path in sorted(held) if not _is_of_the_system(path)]
        script = _OVERLAY.format(
            work=work, clone=self._clone, checkout=CHECKOUT, log=self._log, binds=" ".join(binds)
        )
        outside = subprocess.Popen(
            ["unshare", "--mount", "--propagation", "private", "bash", "-c", script]
        )
        self._running.append(outside)
        self._until(lambda: bool(_manager_of(outside.pid)))
        self.prefix = (
            "nsenter", "--target", str(_manager_of(outside.pid)), "--mount", "--uts", "--ipc",
            "--pid",
        )  # fmt: skip
        self._until(lambda: self._say("systemctl", "is-system-running") in ("running", "degraded"))

    def _plug_in(self) -> None:
        config = load_rig(self._clone / "config" / "rig-raspberrypi.yaml")
        (board,) = config.boards
        emulated = self._clone / "emulated.yaml"
        emulated.write_text(
            f"rig: {config.rig}\n"
            f"ptu: {{port: emulated, baud: {config.ptu.baud}}}\n"
            f"boards: [{{id: {board.id}, port: emulated, baud: {board.baud}}}]\n"
            "emulator: {seed: 1, homed: false}\n"
        )
        with self._log.open("ab") as log:
            emulator = subprocess.Popen(
                [*self.prefix, "gyrorigd", "emulate", "--links", "/run/rig", "--config",
                 str(CHECKOUT / emulated.name)],
                env=self.environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
            )  # fmt: skip
        self._running.append(emulator)
        made = _PORTS.format(board=board.id, ptu=config.ptu.port, port=board.port)
        output = self._say("bash", "-c", made)
        if output or emulator.poll() is not None:
            raise RuntimeError(f"the rig is not there: {output} {self._words()}")

    @property
    def _log(self) -> Path:
        return self._folder / "console.txt"

    def _words(self) -> str:
        text = self._log.read_text(errors="replace") if self._log.exists() else ""
        return str(text.strip().splitlines()[-5:])

    def _say(self, *line: str) -> str:
        ended = subprocess.run(
            [*self.prefix, *line], env=self.environment, stdin=subprocess.DEVNULL,
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        return (ended.stdout + ended.stderr).strip()

    def _until(self, holds: Callable[[], bool]) -> None:
        end_s = time.monotonic() + STARTED_WITHIN_S
        while not holds():
            if self._running[0].poll() is not None or time.monotonic() > end_s:
                raise DoesNotBootError(f"no container comes up here: {self._words()}")
            time.sleep(0.1)

    def _end(self) -> None:
        for process in reversed(self._running):  # the container, on SIGTERM, shuts down
            process.terminate()
            try:
                process.wait(ENDED_WITHIN_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._running = []
        # what it leaves of its control groups, where --keep-unit has put them
        for name in ("payload", "supervisor", "init.scope"):
            for path in sorted(Path("/sys/fs/cgroup").glob(f"**/{name}*"), reverse=True):
                with contextlib.suppress(OSError):
                    path.rmdir()


def _is_of_the_system(path: Path) -> bool:
    return path.is_relative_to("/usr")


def _manager_of(pid: int) -> int:
    """Return the container's first process: what systemd-nspawn has begun, 0 before that."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        named = {int(child): Path(f"/proc/{child}/comm").read_text().strip() for child in children}
    except OSError:
        return 0
    return next((child for child, name in named.items() if name == "systemd"), 0)
