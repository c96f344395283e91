"""What every emulated device is: bytes in at a time, bytes out at a time.

The device never reads a clock. A pty server drives it in real time, the virtual hub
drives it faster than time; both see the same bytes at the same device times.
"""

from typing import Protocol


class EmulatedDevice(Protocol):
    """A device on the far end of a serial line. Times are ns on one monotonic clock."""

    def receive(self, data: bytes, at_ns: int) -> None:
        """Take bytes whose first one begins to arrive at `at_ns`; paced at the baud rate."""
        ...

    def next_output_ns(self) -> int | None:
        """Return when the device's next bytes will have left the line, None if none will."""
        ...

    def take_output(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return what left the line up to `until_ns`, in order, each with its time."""
        ...
