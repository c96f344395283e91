"""The interface between the devices and everything above: ports that are written and read.

Sessions, programs and recorders are the same code whether the bytes come from real ports
through the acquisition process, or from emulated devices under a virtual clock.
"""

from collections import deque
from enum import Enum
from typing import NamedTuple, Protocol, runtime_checkable

from gyrorig_protocol.errors import DeviceError, MachineError


class PortChange(Enum):
    """A port was closed or opened; its chunk has no data."""

    GONE = "gone"  # sent again if the reason changes; the hub keeps trying
    BACK = "back"  # open again, perhaps with another device in an unknown state


class Chunk(NamedTuple):
    """The result of one read call, or a change of a port.

    A named tuple: thousands are made per second, and a frozen dataclass takes four times as long.
    """

    port: str
    received_ns: int  # CLOCK_MONOTONIC_RAW at the return of the read call
    data: bytes
    change: PortChange | None = None
    text: str = ""  # why the port is gone
    late_ns: int = 0  # largest error of the timestamp if the reading process did not run
    is_early: bool = False  # chunks of other ports that are older can still come
    is_after_loss: bool = False  # bytes of this port before it were discarded


class WriteTimes(NamedTuple):
    """When a write started and when the last byte was handed to the system."""

    before_ns: int
    after_ns: int


class PortsGoneError(MachineError):
    """All ports were lost at once; the final command was sent to the devices if possible.

    Example: the acquisition process was killed.
    """


class UnitHaltedError(DeviceError):
    """A write was refused once, because the acquisition process had halted the unit by itself."""

    def __init__(self, reason: str, was_ordered: bool) -> None:
        """Tell the reason.

        Args:
            reason: why the unit was halted.
            was_ordered: whether a person, a signal or another thread ordered the halt.
        """
        super().__init__(
            f"the acquisition process has halted the unit, because {reason}",
            "free the computer from other work, or check its disk. Then start the session again",
        )
        self.was_ordered = was_ordered


class PortHub(Protocol):
    """All ports of a rig, by name, on one raw monotonic clock."""

    def now_ns(self) -> int:
        """Return CLOCK_MONOTONIC_RAW, or the virtual clock in its place, in ns."""
        ...

    def write(self, port: str, data: bytes) -> WriteTimes:
        """Write all of `data`.

        Raises:
            DeviceError: the port is gone, or did not take the bytes before the deadline.
            UnitHaltedError: the unit was halted meanwhile; the next write is accepted.
            PortsGoneError: no port can be reached.
        """
        ...

    def read(self, deadline_ns: int) -> Chunk | None:
        """Return the next chunk of any port in the order of time, None at the deadline.

        Raises:
            PortsGoneError: no port can be reached.
        """
        ...

    def is_up(self, port: str) -> bool:
        """Return whether the port is open, according to the latest `read` and `write`."""
        ...

    def reopen(self, port: str) -> None:
        """Close a port and open it again; chunks with GONE and BACK report it.

        Raises:
            PortsGoneError: no port can be reached.
        """
        ...

    def close(self) -> None:
        """Release every port. It may be closed twice."""
        ...


@runtime_checkable
class BufferedHub(Protocol):
    """A hub that receives many chunks at a time.

    They can be taken without reading the clock.
    """

    @property
    def buffered_chunks(self) -> deque[Chunk]:
        """What `read` would return without waiting, oldest first.

        The caller removes what it takes.
        """
        ...
