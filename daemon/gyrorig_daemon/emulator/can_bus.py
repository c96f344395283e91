"""The emulated CAN bus: one frame at a time, the lowest identifier first, everybody hears.

Theory of operation. Every node has a queue in which its frames keep their order. Whenever the
bus is free, the queues' first frames that are ready compete, and the lowest identifier goes.
What has gone is heard by the host, its own frames too: that is the echo of its edges.
Boards hear the host's frames only; to each other they have nothing to say.

With `is_instant` the host's frames do not compete and are not echoed: where a multicast
group stands for the bus, the host hears its own datagram from the kernel, at the same
moment as the emulator does, and that is the edge.
"""

from collections import deque
from collections.abc import Sequence

from gyrorig_daemon.emulator.board.can_device import EmulatedCanBoard
from gyrorig_daemon.emulator.settings import BusSettings
from gyrorig_protocol.can import CanFrame, pack_frames, unpack_frames

_HOST = -1
_QUEUE_FRAMES = 10  # of a Linux CAN interface (txqueuelen), and of a small controller


def frame_bits(frame: CanFrame) -> int:
    """Return how long a frame is, with about half of the worst stuffing, in bit times.

    Source: ISO 11898-1: 47 bits and the data, 34 of them and the data are stuffed.
    """
    data = 8 * len(frame.data)
    return 47 + data + (34 + data) // 8


class EmulatedCanBus:
    """A bus with its boards; see `device.EmulatedDevice`. Its bytes are packed frames."""

    def __init__(
        self, settings: BusSettings, boards: Sequence[EmulatedCanBoard], origin_ns: int
    ) -> None:
        """Begin with an idle bus at `origin_ns`."""
        self.settings = settings
        self._boards = boards
        self._bit_ns = 1_000_000_000 // settings.bitrate
        self._free_ns = origin_ns
        self._queues: dict[int, deque[tuple[int, CanFrame]]] = {
            node: deque() for node in (_HOST, *range(len(boards)))
        }
        self._sending: tuple[int, int, CanFrame] | None = None  # its end, whose it is

    def receive(self, data: bytes, at_ns: int) -> None:
        """Take packed frames of the host; what its queue does not hold is lost."""
        for frame in unpack_frames(data, at_ns):
            if self.settings.is_instant:
                self._tell(frame, frame.stamp_ns)
            elif len(self._queues[_HOST]) < _QUEUE_FRAMES:
                self._queues[_HOST].append((at_ns, frame))

    def next_output_ns(self) -> int | None:
        """Return when the frame on the bus will have gone, or when the next may begin."""
        return self._begin_ns() if self._sending is None else self._sending[0]

    def take_output(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return the frames that went up to a time, packed, each with its end."""
        gone: list[tuple[int, bytes]] = []
        while self._sending is not None or self._arbitrate(until_ns):
            if self._sending is None or self._sending[0] > until_ns:
                break
            end_ns, node, frame = self._sending
            self._sending = None
            if node == _HOST:
                self._tell(frame, end_ns)
            unstamped = CanFrame(frame.identifier, frame.data, frame.flags)
            gone.append((end_ns, pack_frames([unstamped])))
        return gone

    def _tell(self, frame: CanFrame, edge_ns: int) -> None:
        for board in self._boards:
            board.hear(frame, edge_ns)

    def _begin_ns(self) -> int | None:
        """Return when the bus is free and somebody wants it."""
        ready = [queue[0][0] for queue in self._queues.values() if queue]
        for node, board in enumerate(self._boards):
            if not self._queues[node] and (due_ns := board.next_output_ns()) is not None:
                ready.append(due_ns)
        return max(self._free_ns, min(ready)) if ready else None

    def _arbitrate(self, until_ns: int) -> bool:
        """Put the next frame on the bus if one begins by a time; return whether one may.

        Only what is ready by then is taken from the boards: what they send later may yet
        change with the motion.
        """
        begin_ns = self._begin_ns()
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
            self._sending = self._free_ns, node, frame
        return True
