"""A machine in qemu: its USB adapter can be pulled, its power cut, its words read.

What to use when: `Machine(image, port)` as a context. No hardware virtualisation is needed
(TCG); a boot takes half a minute then.
"""

import json
import shutil
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from tests.qemu.image import Image

SERIAL = "RIG0001"
PLUG = f"usb-serial,chardev=ser0,always-plugged=on,serial={SERIAL}"

FAULT_S = 120.0  # for all of what a guest says when it gives up
# On a busy host an emulated timer is late, which Linux takes for a broken one.
ARGUMENTS = "root=/dev/vda rw console=ttyS0 quiet no_timer_check panic=-1"


class Machine:
    """A running machine."""

    def __init__(self, image: Image, port: str, folder: Path) -> None:
        """Prepare it.

        Args:
            image: what it starts from; its disk is written to, so give a copy.
            port: the pty of the unit behind the USB adapter.
            folder: for the monitor and what the machine says.
        """
        self._words = folder / "words.txt"
        self._monitor = folder / "monitor.sock"
        self.console = folder / "console.txt"
        self._plugs = 0
        self._process: subprocess.Popen[bytes] | None = None
        self._command = [
            # All that the processor can be taught: numpy needs x86-64-v2, more than the default.
            "qemu-system-x86_64", "-accel", "tcg,thread=multi", "-cpu", "max",
            "-smp", "2", "-m", "1024", "-display", "none", "-no-reboot",
            "-kernel", str(image.kernel), "-initrd", str(image.initrd), "-append", ARGUMENTS,
            "-drive", f"file={image.disk},format=raw,if=virtio", "-net", "none",
            "-device", "qemu-xhci", "-chardev", f"serial,id=ser0,path={port}",
            "-device", f"{PLUG},id=ftdi0", "-serial", f"file:{self.console}",
            "-serial", f"file:{self._words}",
            "-qmp", f"unix:{self._monitor},server=on,wait=off",
        ]  # fmt: skip

    def __enter__(self) -> "Machine":
        """Switch it on."""
        self._process = subprocess.Popen(self._command)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Switch it off, if it is still on."""
        self.cut()

    def cut(self) -> None:
        """Cut its power: what the guest has not written is lost."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def words(self) -> list[str]:
        """Return the lines that it has said."""
        if not self._words.exists():
            return []
        return self._words.read_text(errors="replace").replace("\r", "").splitlines()

    def wait_for(self, beginning: str, limit_s: float) -> str:
        """Return the first line with a beginning; raises when it does not come."""
        lines: list[str] = []
        faults: list[str] = []

        def look() -> bool:
            words = self.words()
            lines[:] = [line for line in words if line.startswith(beginning)]
            faults[:] = [line for line in words if line.startswith("FAULT")]
            ended = self._process is None or self._process.poll() is not None
            return bool(lines or faults) or ended

        until(look, limit_s, lambda: "\n".join(self.words()[-20:]))
        if faults and not lines:
            end_s = time.monotonic() + FAULT_S
            while "FAULT end" not in self.words() and time.monotonic() < end_s:
                time.sleep(0.5)
            raise RuntimeError("in the machine:\n" + "\n".join(self.words()))
        if not lines:
            raise RuntimeError(f"the machine ended: {self.words()[-20:]}")
        return lines[0]

    def unplug(self) -> None:
        """Pull the USB adapter."""
        self._say("device_del", id=f"ftdi{self._plugs}")

    def plug(self) -> None:
        """Plug it in again."""
        self._plugs += 1
        self._say(
            "device_add", driver="usb-serial", chardev="ser0", id=f"ftdi{self._plugs}",
            **{"always-plugged": True, "serial": SERIAL},
        )  # fmt: skip

    def _say(self, command: str, **arguments: object) -> None:
        with socket.socket(socket.AF_UNIX) as monitor:
            monitor.connect(str(self._monitor))
            file = monitor.makefile("rw")
            file.readline()  # its greeting
            for word, more in (("qmp_capabilities", {}), (command, arguments)):
                file.write(json.dumps({"execute": word, "arguments": more}) + "\n")
                file.flush()
                while "return" not in (answer := json.loads(file.readline())):
                    if "error" in answer:
                        raise RuntimeError(f"{command}: {answer['error']}")


def until(holds: Callable[[], bool], limit_s: float, description: Callable[[], str]) -> None:
    """Wait for a condition; raises with what `description` returns when it does not come."""
    end_s = time.monotonic() + limit_s
    while not holds():
        if time.monotonic() > end_s:
            raise TimeoutError(f"waited {limit_s:g} s in vain:\n{description()}")
        time.sleep(0.1)


def missing_tools() -> list[str]:
    """Return the programs that are needed and not here."""
    needed = ("qemu-system-x86_64", "mmdebstrap", "mke2fs", "systemctl", "mount")
    return [name for name in needed if shutil.which(name) is None]
