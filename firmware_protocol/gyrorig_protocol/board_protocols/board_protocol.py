"""The interface of a board's protocol to the daemon.

What to use when: subclass `SerialProtocol` for a board on a serial port, `CanProtocol` for one on a
CAN bus.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Protocol

from gyrorig_protocol.board import BoardEvent, ColumnMap, FaultCause, HelloRequest, TimeRequest
from gyrorig_protocol.can import CanBoardEvent, CanFrame, SignalMap
from gyrorig_protocol.errors import UsageError

OptionValue = str | int | float | bool


class BoardFacts(Protocol):
    """What a rig file says of a board that does not identify itself."""

    @property
    def uid(self) -> str | None:
        """The unique id."""
        ...

    @property
    def sensor(self) -> str | None:
        """The type of the sensor."""
        ...

    @property
    def gyro_scale_rad_s(self) -> float | None:
        """rad/s per count."""
        ...


class BoardEntry(Protocol):
    """One board in a rig file."""

    @property
    def id(self) -> str:
        """The name of the board."""
        ...

    @property
    def node(self) -> int | None:
        """The number on a CAN bus."""
        ...

    @property
    def columns(self) -> ColumnMap | None:
        """The columns of text lines."""
        ...

    @property
    def signals(self) -> SignalMap | None:
        """The signals of CAN frames."""
        ...

    @property
    def options(self) -> Mapping[str, OptionValue]:
        """Values that only the protocol of this board knows."""
        ...

    @property
    def facts(self) -> BoardFacts:
        """What the board does not report."""
        ...


class SerialParser(Protocol):
    """Parses the bytes of a board; see `board.FrameParser` for the contract."""

    faults: dict[FaultCause, int]

    def feed(self, data: bytes, received_ns: int) -> Sequence[BoardEvent]:
        """Return the events that `data` completes."""
        ...

    def reset(self) -> None:
        """Drop an unfinished frame."""
        ...


class CanParser(Protocol):
    """Parses the frames of a board on a bus."""

    faults: dict[FaultCause, int]

    def wants(self, key: int) -> bool:
        """Return whether frames with this key are the board's."""
        ...

    def feed(self, frame: CanFrame) -> Sequence[CanBoardEvent]:
        """Return the events that a frame completes."""
        ...

    def reset(self) -> None:
        """Drop an unfinished sample."""
        ...


class BoardProtocol(ABC):
    """What the daemon needs to know of a protocol. Instances have no state."""

    name: str  # the value of `format` in a rig file
    description: str  # of what the board sends, for example "lines of numbers"
    on_bus: bool
    identifies_itself = False  # by a `Hello`, on request
    answers_time_requests = False  # by a `TimeReply`
    counter_bits: int | None = None  # of a sample's timestamp; None: what `facts` say, or 64
    sequence_bits = 32  # of a sample's number
    required_keys: Mapping[str, str] = MappingProxyType({})  # of the rig file: what to add
    optional_keys: tuple[str, ...] = ()  # of the rig file

    @property
    def sends_clock_at_edges(self) -> bool:
        """Whether the board reports its clock at the edges of a bus."""
        return self.on_bus and self.identifies_itself

    def scales(self, board: BoardEntry) -> Mapping[str, str | float | int | None]:
        """Return entries of the recording's metadata that the protocol gives; None: unknown."""
        del board
        return {}

    def check_settings(self, board: BoardEntry, name: str) -> None:
        """Check a board's entry in a rig file; `name`: of the file.

        Raises:
            UsageError: a value is missing or wrong.
        """
        if self.identifies_itself:
            return
        facts = board.facts
        scale = facts.gyro_scale_rad_s or self.scales(board).get("gyro_scale_rad_s")
        if not (facts.uid and facts.sensor and scale):
            raise UsageError(
                f"{name}: the `facts` of board {board.id} are incomplete, and a board with "
                f"`format: {self.name}` does not identify itself",
                "add `uid`, `sensor` and, if the board sends counts, `gyro_scale_rad_s` under "
                "`facts`",
            )


class SerialProtocol(BoardProtocol):
    """A protocol on a serial port."""

    on_bus = False
    overhead_bytes = 0  # of a frame, in addition to the `payload` of its event
    sample_bytes: int  # of a sample on the line

    @abstractmethod
    def make_parser(self, board: BoardEntry) -> SerialParser:
        """Return a parser of the board's bytes."""

    def hello_request(self) -> bytes:
        """Return the bytes that ask a board for its identity; only if `identifies_itself`."""
        return HelloRequest().encode()

    def time_request(self, nonce: int, host_stamp_ns: int) -> bytes:
        """Return the bytes that ask a board for its time; only if `answers_time_requests`."""
        return TimeRequest(nonce, host_stamp_ns).encode()


class CanProtocol(BoardProtocol):
    """A protocol on a CAN bus."""

    on_bus = True

    @abstractmethod
    def make_parser(self, board: BoardEntry) -> CanParser:
        """Return a parser of the board's frames."""

    def hello_request(self, board: BoardEntry) -> CanFrame | None:
        """Return the frame that asks a board for its identity; only if `identifies_itself`."""
        del board
        return None
