"""The one seam between real and simulated time: ports that are written and read.

Everything above this seam (sessions, programs, recorders) is the same code whether the
bytes come from serial ports through the acquisition process or from emulated devices
under a virtual clock.
"""

from dataclasses import dataclass
from typing import Protocol

from gyrorig_protocol.errors import MachineError


@dataclass(frozen=True, slots=True)
class Chunk:
    """What one read call returned; `data` is empty when the port hung up."""

    port: str
    received_ns: int  # CLOCK_MONOTONIC_RAW at the return of the read call
    data: bytes


@dataclass(frozen=True, slots=True)
class WriteStamp:
    """When a write began and when the last byte was handed to the system."""

    before_ns: int
    after_ns: int


class PortsGoneError(MachineError):
    """Every port was lost at once; what can be said to the devices has been said.

    Example: the acquisition process was killed.
    """


class PortHub(Protocol):
    """All ports of a rig, by name, on one raw monotonic clock."""

    def now_ns(self) -> int:
        """Return CLOCK_MONOTONIC_RAW, or the virtual clock that stands for it, in ns."""
        ...

    def write(self, port: str, data: bytes) -> WriteStamp:
        """Write all of `data`.

        Raises:
            DeviceError: the port hung up, or did not take the bytes before the deadline.
            PortsGoneError: nothing reaches any port any more.
        """
        ...

    def read(self, deadline_ns: int) -> Chunk | None:
        """Return the next chunk of any port in the order of time, None at the deadline.

        Raises:
            PortsGoneError: nothing comes from any port any more.
        """
        ...

    def close(self) -> None:
        """Release every port. Closing twice is no fault."""
        ...
