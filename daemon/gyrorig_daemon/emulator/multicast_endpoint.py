"""Endpoint of an emulated CAN bus in real time: a multicast group on the loopback interface.

Its datagrams are those of python-can's udp_multicast interface, so that every program that uses
python-can can be on the bus. Nothing leaves the computer.
"""

import socket

from gyrorig_daemon.links.can.multicast_line import MulticastLine, multicast_datagram
from gyrorig_protocol.can.can_frame import unpack_frames

GROUP = "239.74.163.2"  # python-can's own default
LOOPBACK = "127.0.0.1"


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
