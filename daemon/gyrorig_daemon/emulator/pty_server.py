"""Emulated rig in real time: each device on a pty that any program can open.

What to use when: `serve_rig` from a command line; `PtyServer` if the caller runs the loop. A CAN
bus is a multicast group on the loopback interface instead (`MulticastEndpoint`).

Bytes are sent when they are due by CLOCK_MONOTONIC_RAW; bytes of a client reach the device when
they arrive. Without a client, bytes are lost, as on a real line: a device does not wait for a
listener, and a new client receives no old bytes.
"""

import contextlib
import os
import select
import socket
import termios
import time
import tty
from collections.abc import Callable, Mapping
from pathlib import Path

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.links.can.multicast_line import MulticastLine, multicast_datagram
from gyrorig_protocol.can.can_frame import unpack_frames
from gyrorig_protocol.errors import MachineError

GROUP = "239.74.163.2"  # python-can's own default
LOOPBACK = "127.0.0.1"
_MAX_WAIT_S = 0.02  # longest delay until a new client or a stop is noticed
_READ_BYTES = 4096


class MulticastEndpoint:
    """The emulator's side of a bus."""

    is_open = True  # a bus does not wait for a listener

    def __init__(self) -> None:
        """Join the group on a free port.

        Raises:
            OSError: multicast is not available.
        """
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(
                (GROUP, 0)
            )  # an address of the group, so that no other emulator's bus is joined
            self._destination = (GROUP, int(probe.getsockname()[1]))
        self._line = MulticastLine(*self._destination, LOOPBACK)
        self._sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sender.setsockopt(
            socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(LOOPBACK)
        )
        self._sender.bind((LOOPBACK, 0))
        self._sender.setblocking(False)
        # It would receive its own datagrams, because the group receives every sender's.
        self._line.ignored_sender = self._sender.getsockname()
        self.path = f"udp_multicast:{GROUP}:{self._destination[1]}@{LOOPBACK}"

    @property
    def descriptor(self) -> int:
        """The file descriptor to wait for."""
        return self._line.fd

    def update_presence(self) -> None:
        """Do nothing: a bus is always open."""

    def read(self) -> bytes:
        """Return the frames of others, packed, with the kernel's timestamps."""
        try:
            return self._line.read()
        except OSError:  # no data
            return b""

    def write(self, data: bytes) -> None:
        """Send packed frames; frames that the socket does not accept are lost."""
        for frame in unpack_frames(data, 0):
            datagram = multicast_datagram(frame.identifier, frame.flags, frame.data)
            try:
                self._sender.sendto(datagram, self._destination)
            except OSError:
                return

    def close(self) -> None:
        """Leave the group."""
        self._line.close()
        self._sender.close()


def raw_now_ns() -> int:
    """Return the time of the devices' clock."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)


class _Pty:
    """The device's end of a line; the master stays open while clients connect and leave."""

    def __init__(self) -> None:
        self.descriptor, slave = os.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self.descriptor, False)
        self._poll = select.poll()
        self._poll.register(self.descriptor, select.POLLHUP)
        self.is_open = False

    def update_presence(self) -> None:
        """Update whether a client is connected; discard what a client has left unread."""
        now_open = not self._poll.poll(0)
        if self.is_open and not now_open:
            # Fails if the client has left the port exclusive; then the client discards its data.
            with contextlib.suppress(OSError):
                slave = os.open(self.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                termios.tcflush(slave, termios.TCIFLUSH)
                tty.setraw(slave)
                os.close(slave)
        self.is_open = now_open

    def read(self) -> bytes:
        """Return what a client has written, also if it has closed since."""
        try:
            return os.read(self.descriptor, _READ_BYTES)
        except OSError:  # no data, or the client has left
            return b""

    def write(self, data: bytes) -> None:
        """Deliver bytes; bytes beyond the receive buffer are lost."""
        if self.is_open:
            try:
                os.write(self.descriptor, data)
            except OSError:
                return

    def close(self) -> None:
        os.close(self.descriptor)


class PtyServer:
    """Drives an emulated rig on ptys; `paths` is known before `run`."""

    def __init__(self, rig: EmulatedRig, links: Path | None = None) -> None:
        """Open a pty for each device.

        Args:
            rig: its origin must be a time of CLOCK_MONOTONIC_RAW, best the present.
            links: folder for symbolic links with the port names, with `-` for `:`; None for no
                links.

        Raises:
            MachineError: a pty cannot be opened, or a link cannot be created.
        """
        self._devices = rig.devices
        self._ptys: dict[str, _Pty | MulticastEndpoint] = {}
        self._links: list[tuple[Path, str]] = []
        try:
            for port in self._devices:
                self._ptys[port] = MulticastEndpoint() if port.startswith("bus:") else _Pty()
        except OSError as error:
            self.close()
            raise MachineError(
                "the emulator cannot open a pseudo-terminal or multicast group for the port "
                f"{port} ({error.strerror})",
                "end other emulated rigs, or increase the limit of pseudo-terminals in "
                "/proc/sys/kernel/pty/max",
            ) from error
        try:
            if links is not None:
                self._make_links(links)
        except OSError as error:
            self.close()
            raise MachineError(
                f"the emulator cannot create links to its ports in {links} ({error.strerror})",
                "give another folder with --links",
            ) from error
        self._by_fd = {pty.descriptor: port for port, pty in self._ptys.items()}

    @property
    def paths(self) -> dict[str, str]:
        """The path of each device, by port name."""
        return {port: pty.path for port, pty in self._ptys.items()}

    def run(self, stop: Callable[[], bool]) -> None:
        """Serve until `stop` returns True; it is called at least 50 times per second."""
        while not stop():
            for pty in self._ptys.values():
                pty.update_presence()
            self._deliver()
            readers = [pty.descriptor for pty in self._ptys.values() if pty.is_open]
            try:
                ready, _, _ = select.select(readers, (), (), self._wait_s())
            except InterruptedError:
                continue
            closed = [pty.descriptor for pty in self._ptys.values() if not pty.is_open]
            for fd in (*ready, *closed):
                port = self._by_fd[fd]
                data = self._ptys[port].read()
                if data:
                    self._devices[port].receive(data, raw_now_ns())

    def close(self) -> None:
        """Remove the links and close every pty; a second call does nothing."""
        for link, path in self._links:
            with contextlib.suppress(OSError):
                if str(link.readlink()) == path:  # it can be the link of another emulator
                    link.unlink()
        for pty in self._ptys.values():
            pty.close()
        self._links, self._ptys = [], {}

    def _deliver(self) -> None:
        now_ns = raw_now_ns()
        for port, device in self._devices.items():
            sent = device.take_output(now_ns)
            if sent:
                self._ptys[port].write(b"".join(data for _, data in sent))

    def _wait_s(self) -> float:
        due_times = [
            due_ns
            for due_ns in (device.next_output_ns() for device in self._devices.values())
            if due_ns is not None
        ]
        if not due_times:
            return _MAX_WAIT_S
        return min(max((min(due_times) - raw_now_ns()) * 1e-9, 0.0), _MAX_WAIT_S)

    def _make_links(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for port, pty in self._ptys.items():
            if isinstance(pty, MulticastEndpoint):
                continue  # no file
            link = folder / port.replace(":", "-")
            if link.is_symlink():
                link.unlink()
            link.symlink_to(pty.path)
            self._links.append((link, pty.path))


def serve_rig(
    rig: EmulatedRig,
    announce: Callable[[Mapping[str, str]], None],
    stop: Callable[[], bool],
    links: Path | None = None,
) -> None:
    """Run the rig's devices on ptys in real time until `stop` returns True.

    Args:
        rig: powered up at a time of CLOCK_MONOTONIC_RAW.
        announce: called once with the path of each port, when all are open.
        stop: called at least 50 times per second.
        links: a folder for symbolic links with the port names.

    Raises:
        MachineError: a pty cannot be opened.
    """
    server = PtyServer(rig, links)
    try:
        announce(server.paths)
        server.run(stop)
    finally:
        server.close()
