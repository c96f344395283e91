"""Interface of every emulated device: bytes in and out, each at a time.

A device never reads a clock. A pty server drives it in real time, and the virtual hub drives it in
simulated time. Both see the same bytes at the same device times.
"""

from typing import Protocol


class EmulatedDevice(Protocol):
    """A device on the far end of a serial line. Times are ns on one monotonic clock."""

    def receive(self, data: bytes, at_ns: int) -> None:
        """Accept bytes that arrive from `at_ns` on, at the baud rate."""
        ...

    def next_output_ns(self) -> int | None:
        """Return when the next bytes have left the line, None if there are none."""
        ...

    def take_output(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return the bytes that have left the line up to `until_ns`, in order, with their times."""
        ...
