"""An emulated CAN bus's end in real time: a multicast group on the loopback interface.

Its datagrams are those of python-can's udp_multicast interface, so that the daemon, and any
program that speaks python-can, can be on the bus. Nothing leaves the machine.
"""

import socket

from gyrorig_daemon.links.can_multicast import MulticastLine, multicast_datagram
from gyrorig_protocol.can.frame import unpack_frames

GROUP = "239.74.163.2"  # python-can's own default
LOOPBACK = "127.0.0.1"


class MulticastEnd:
    """The emulator's side of one bus."""

    open = True  # whoever listens: a bus does not wait

    def __init__(self) -> None:
        """Join the group on a port that is free.

        Raises:
            OSError: there is no multicast here.
        """
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((GROUP, 0))  # of the group: another emulator's bus is never joined
            self._destination = (GROUP, int(probe.getsockname()[1]))
        self._line = MulticastLine(*self._destination, LOOPBACK)
        self._sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sender.setsockopt(
            socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(LOOPBACK)
        )
        self._sender.bind((LOOPBACK, 0))
        self._sender.setblocking(False)
        # What it sends comes back to it: the group hears every sender.
        self._line.deaf_to = self._sender.getsockname()
        self.path = f"udp_multicast:{GROUP}:{self._destination[1]}@{LOOPBACK}"

    @property
    def master(self) -> int:
        """What to wait for."""
        return self._line.fd

    def look(self) -> None:
        """Do nothing: nobody opens or closes a bus."""

    def read(self) -> bytes:
        """Return what others sent as packed frames, with the kernel's stamps."""
        try:
            return self._line.read()
        except OSError:  # nothing there
            return b""

    def write(self, data: bytes) -> None:
        """Send packed frames; what does not fit is lost."""
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
