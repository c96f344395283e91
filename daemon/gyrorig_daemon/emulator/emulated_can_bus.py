"""Emulated CAN bus: one frame at a time, arbitration by the lowest identifier.

Theory of operation. Every node has a queue in which its frames keep their order. When the bus is
free, the first ready frames of all queues compete, and the lowest identifier is sent. The host
receives every frame that was sent, also its own, which is the echo of its SYNC frames. Boards
receive only the frames of the host.

With `is_instant` the host's frames do not compete and are not echoed. If a multicast group replaces
the bus, the host receives its own datagram from the kernel, at the same moment as the emulator, and
that is the echo.
"""

from collections import deque
from collections.abc import Sequence

from gyrorig_daemon.emulator.board.emulated_can_board import EmulatedCanBoard
from gyrorig_daemon.emulator.emulator_settings import BusSettings
from gyrorig_protocol.can import CanFrame, pack_frames, unpack_frames

_HOST = -1
_QUEUE_FRAMES = 10  # of a Linux CAN interface (txqueuelen), and of a small controller


def frame_bits(frame: CanFrame) -> int:
    """Return the length of a frame in bit times, with about half of the worst-case stuffing.

    Source: ISO 11898-1: 47 bits and the data, 34 of them and the data are stuffed.
    """
    data = 8 * len(frame.data)
    return 47 + data + (34 + data) // 8


class EmulatedCanBus:
    """A bus with its boards; see `device.EmulatedDevice`. Its bytes are packed frames."""

    def __init__(
        self, settings: BusSettings, boards: Sequence[EmulatedCanBoard], origin_ns: int
    ) -> None:
        """Start with an idle bus at `origin_ns`."""
        self.settings = settings
        self._boards = boards
        self._bit_ns = 1_000_000_000 // settings.bitrate
        self._free_ns = origin_ns
        self._queues: dict[int, deque[tuple[int, CanFrame]]] = {
            node: deque() for node in (_HOST, *range(len(boards)))
        }
        self._frame_on_bus: tuple[int, int, CanFrame] | None = None  # its end, its node

    def receive(self, data: bytes, at_ns: int) -> None:
        """Accept packed frames of the host; frames beyond its queue are lost."""
        for frame in unpack_frames(data, at_ns):
            if self.settings.is_instant:
                self._deliver_to_boards(frame, frame.timestamp_ns)
            elif len(self._queues[_HOST]) < _QUEUE_FRAMES:
                self._queues[_HOST].append((at_ns, frame))

    def next_output_ns(self) -> int | None:
        """Return when the frame on the bus ends, or when the next one can start."""
        return self._next_start_ns() if self._frame_on_bus is None else self._frame_on_bus[0]

    def take_output(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return the frames that were sent up to a time, packed, each with its end."""
        sent: list[tuple[int, bytes]] = []
        while self._frame_on_bus is not None or self._arbitrate(until_ns):
            if self._frame_on_bus is None or self._frame_on_bus[0] > until_ns:
                break
            end_ns, node, frame = self._frame_on_bus
            self._frame_on_bus = None
            if node == _HOST:
                self._deliver_to_boards(frame, end_ns)
            unstamped = CanFrame(frame.identifier, frame.data, frame.flags)
            sent.append((end_ns, pack_frames([unstamped])))
        return sent

    def _deliver_to_boards(self, frame: CanFrame, edge_ns: int) -> None:
        for board in self._boards:
            board.receive_frame(frame, edge_ns)

    def _next_start_ns(self) -> int | None:
        """Return when the next frame can start, None if no node has one."""
        ready = [queue[0][0] for queue in self._queues.values() if queue]
        for node, board in enumerate(self._boards):
            if not self._queues[node] and (due_ns := board.next_output_ns()) is not None:
                ready.append(due_ns)
        return max(self._free_ns, min(ready)) if ready else None

    def _arbitrate(self, until_ns: int) -> bool:
        """Put the next frame on the bus if one starts by a time; return whether one can.

        Only frames that are ready by then are taken from the boards, because later ones can still
        change with the motion.
        """
        begin_ns = self._next_start_ns()
        if begin_ns is None or begin_ns > until_ns:
            return False
        for node, board in enumerate(self._boards):
            if not self._queues[node]:
                for ready_ns, data in board.take_output(begin_ns):
                    frames = unpack_frames(data, ready_ns)
                    self._queues[node].extend((ready_ns, frame) for frame in frames)
        heads = [
            (queue[0][1].identifier, node)
            for node, queue in self._queues.items()
            if queue and queue[0][0] <= begin_ns
        ]
        if heads:
            node = min(heads)[1]
            _, frame = self._queues[node].popleft()
            self._free_ns = begin_ns + frame_bits(frame) * self._bit_ns
            self._frame_on_bus = self._free_ns, node, frame
        return True
