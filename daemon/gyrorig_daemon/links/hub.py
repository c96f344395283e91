"""The one seam between real and simulated time: ports that are written and read.

Everything above this seam (sessions, programs, recorders) is the same code whether the
bytes come from serial ports through the acquisition process or from emulated devices
under a virtual clock.
"""

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, Protocol, runtime_checkable

from gyrorig_protocol.errors import MachineError


class PortChange(Enum):
    """What became of a port; its chunk has no data."""

    GONE = "gone"  # said again where the reason has changed; the hub goes on trying
    BACK = "back"  # open again: perhaps another device, its state unknown


class Chunk(NamedTuple):
    """What one read call returned, or that the port went away or came back.

    A named tuple: thousands of them are made a second, and a frozen dataclass costs four
    times as much.
    """

    port: str
    received_ns: int  # CLOCK_MONOTONIC_RAW at the return of the read call
    data: bytes
    change: PortChange | None = None
    text: str = ""  # why it is gone
    late_ns: int = 0  # how late the stamp may be: the reading process had stood still


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
            DeviceError: the port is gone, or did not take the bytes before the deadline.
            PortsGoneError: nothing reaches any port any more.
        """
        ...

    def read(self, deadline_ns: int) -> Chunk | None:
        """Return the next chunk of any port in the order of time, None at the deadline.

        Raises:
            PortsGoneError: nothing comes from any port any more.
        """
        ...

    def is_up(self, port: str) -> bool:
        """Return whether the port is open, by what `read` and `write` have learnt so far."""
        ...

    def reopen(self, port: str) -> None:
        """Let go of a port and open it anew; its chunks GONE and BACK tell when.

        Raises:
            PortsGoneError: nothing reaches any port any more.
        """
        ...

    def close(self) -> None:
        """Release every port. Closing twice is no fault."""
        ...


@runtime_checkable
class GatheringHub(Protocol):
    """A hub to which chunks come many at a time, to be handed out without a look at the clock."""

    @property
    def at_hand(self) -> deque[Chunk]:
        """What `read` would return without waiting, the next one first; to be taken from it."""
        ...
