"""The emulated rig in real time: each device on a pty that any program may open.

A CAN bus is a multicast group on the loopback interface instead, see `multicast_end`.

Bytes go out when they are due by CLOCK_MONOTONIC_RAW; what a client writes reaches the
device as it comes. Nobody on the other side means that bytes are lost, as on a real line:
a device does not wait for a listener, and a new client finds no old bytes.
"""

import contextlib
import os
import select
import termios
import time
import tty
from collections.abc import Callable
from pathlib import Path

from gyrorig_daemon.emulator.multicast_end import MulticastEnd
from gyrorig_daemon.emulator.rig import EmulatedRig
from gyrorig_protocol.errors import MachineError

_LONGEST_WAIT_S = 0.02  # how late a new client or the wish to stop may be noticed
_READ_BYTES = 4096


def raw_now_ns() -> int:
    """Return the clock that the devices run on."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)


class _Pty:
    """One device's end of a line; the master stays open, clients come and go."""

    def __init__(self) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self.master, False)
        self._poll = select.poll()
        self._poll.register(self.master, select.POLLHUP)
        self.open = False

    def look(self) -> None:
        """Note whether a client is there; throw away what one has left unread."""
        now_open = not self._poll.poll(0)
        if self.open and not now_open:
            # Refused where the client has left the port exclusive: it clears up itself then.
            with contextlib.suppress(OSError):
                slave = os.open(self.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                termios.tcflush(slave, termios.TCIFLUSH)
                tty.setraw(slave)
                os.close(slave)
        self.open = now_open

    def read(self) -> bytes:
        """Return what was written; also by a client that has closed since."""
        try:
            return os.read(self.master, _READ_BYTES)
        except OSError:  # nothing there, or the client left
            return b""

    def write(self, data: bytes) -> None:
        """Deliver bytes; what does not fit is lost, as in a full receive buffer."""
        if self.open:
            try:
                os.write(self.master, data)
            except OSError:
                return

    def close(self) -> None:
        os.close(self.master)


class PtyServer:
    """Drives an emulated rig on ptys.

    Opening is done at once, so that `paths` can be told before `run` begins.
    """

    def __init__(self, rig: EmulatedRig, links: Path | None = None) -> None:
        """Open a pty for each device.

        Args:
            rig: its origin must be a time of CLOCK_MONOTONIC_RAW, best the present.
            links: a folder in which each port gets a symbolic link of its name, with `-`
                for `:`; none are made where it is None.

        Raises:
            MachineError: no pty can be opened, or a link cannot be made.
        """
        self._devices = rig.devices
        self._ptys: dict[str, _Pty | MulticastEnd] = {}
        self._links: list[tuple[Path, str]] = []
        try:
            for port in self._devices:
                self._ptys[port] = MulticastEnd() if port.startswith("bus:") else _Pty()
        except OSError as fault:
            self.close()
            raise MachineError(
                f"no pty or multicast group can be opened for {port}: {fault.strerror}",
                "end other emulated rigs; /proc/sys/kernel/pty/max says how many ptys there are",
            ) from fault
        try:
            if links is not None:
                self._make_links(links)
        except OSError as fault:
            self.close()
            raise MachineError(
                f"links cannot be made in {links}: {fault.strerror}",
                "name another folder with --links",
            ) from fault
        self._by_fd = {pty.master: port for port, pty in self._ptys.items()}

    @property
    def paths(self) -> dict[str, str]:
        """Where a client finds each device, by port name."""
        return {port: pty.path for port, pty in self._ptys.items()}

    def run(self, stop: Callable[[], bool]) -> None:
        """Serve until `stop` returns True; it is asked at least 50 times a second."""
        while not stop():
            for pty in self._ptys.values():
                pty.look()
            self._deliver()
            readers = [pty.master for pty in self._ptys.values() if pty.open]
            try:
                ready, _, _ = select.select(readers, (), (), self._wait_s())
            except InterruptedError:
                continue
            closed = [pty.master for pty in self._ptys.values() if not pty.open]
            for fd in (*ready, *closed):
                port = self._by_fd[fd]
                data = self._ptys[port].read()
                if data:
                    self._devices[port].receive(data, raw_now_ns())

    def close(self) -> None:
        """Remove the links and close every pty. Closing twice is no fault."""
        for link, path in self._links:
            with contextlib.suppress(OSError):
                if str(link.readlink()) == path:  # another emulator may have put its own there
                    link.unlink()
        for pty in self._ptys.values():
            pty.close()
        self._links, self._ptys = [], {}

    def _deliver(self) -> None:
        now_ns = raw_now_ns()
        for port, device in self._devices.items():
            pieces = device.take_output(now_ns)
            if pieces:
                self._ptys[port].write(b"".join(data for _, data in pieces))

    def _wait_s(self) -> float:
        dues = [d for d in (v.next_output_ns() for v in self._devices.values()) if d is not None]
        if not dues:
            return _LONGEST_WAIT_S
        return min(max((min(dues) - raw_now_ns()) * 1e-9, 0.0), _LONGEST_WAIT_S)

    def _make_links(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for port, pty in self._ptys.items():
            if isinstance(pty, MulticastEnd):
                continue  # no file
            link = folder / port.replace(":", "-")
            if link.is_symlink():
                link.unlink()
            link.symlink_to(pty.path)
            self._links.append((link, pty.path))
