"""Read what a DBC file says of messages and signals: the part of the format that is needed.

What to use when: `parse_dbc` for the text of a file that a person gave; `Signal.raw` and
`Signal.physical` for frames. Read are BO_, SG_, SIG_VALTYPE_ (floats) and the plain
multiplexer marks, which are refused; everything else in the file is passed over. Nodes,
comments, attributes and value tables say nothing that a sample needs.

Source of the grammar: Vector's DBC file format documentation, version 1.0.5; checked in the
tests against cantools, an independent reader.
"""

import re
import struct
from dataclasses import dataclass, replace

from gyrorig_protocol.errors import UsageError

MAX_TEXT_BYTES = 4 << 20
_NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
_MESSAGE = re.compile(r"BO_\s+(\d{1,10})\s+(\w{1,128})\s*:\s*(\d{1,4})\s")
_SIGNAL = re.compile(
    rf"SG_\s+(\w{{1,128}})\s*(M|m\d+M?)?\s*:\s*(\d{{1,3}})\|(\d{{1,2}})@([01])([-+])"
    rf"\s*\(\s*{_NUMBER}\s*,\s*{_NUMBER}\s*\)\s*\[\s*{_NUMBER}\s*\|\s*{_NUMBER}\s*\]"
    r'\s*"([^"]{0,64})"'
)
_FLOAT = re.compile(r"SIG_VALTYPE_\s+(\d{1,10})\s+(\w{1,128})\s*:?\s*([012])\s*;")
_EXTENDED = 1 << 31
_FLOATS = {(32, True): "<f", (32, False): ">f", (64, True): "<d", (64, False): ">d"}


@dataclass(frozen=True, slots=True)
class Signal:
    """One signal of a message: where its bits are and what they mean."""

    name: str
    start: int  # as in the file: the least bit of Intel order, the greatest of Motorola's
    length: int
    is_intel: bool  # little-endian
    is_signed: bool
    factor: float
    offset: float
    minimum: float  # minimum == maximum: the file states no range
    maximum: float
    unit: str
    is_float: bool = False

    @property
    def last_byte(self) -> int:
        """The last byte of the frame that the signal needs."""
        if self.is_intel:
            return (self.start + self.length - 1) // 8
        return (self._from_top() + self.length - 1) // 8

    def raw(self, data: bytes) -> int | float:
        """Return the bits as a number, not scaled; `data` must reach to `last_byte`."""
        mask = (1 << self.length) - 1
        if self.is_intel:
            bits = int.from_bytes(data, "little") >> self.start & mask
        else:
            behind = 8 * len(data) - self._from_top() - self.length
            bits = int.from_bytes(data, "big") >> behind & mask
        if self.is_float:
            number: float = struct.unpack(
                _FLOATS[self.length, True], bits.to_bytes(self.length // 8, "little")
            )[0]
            return number
        if self.is_signed and bits >> (self.length - 1):
            bits -= 1 << self.length
        return bits

    def physical(self, data: bytes) -> float:
        """Return the value in `unit`."""
        return self.raw(data) * self.factor + self.offset

    def _from_top(self) -> int:
        """Return the place of the greatest bit, counted from the first bit sent (Motorola)."""
        return self.start // 8 * 8 + 7 - self.start % 8


@dataclass(frozen=True, slots=True)
class Message:
    """One message: its identifier and its signals by name."""

    name: str
    identifier: int
    is_extended: bool
    length: int
    signals: dict[str, Signal]

    @property
    def key(self) -> int:
        """The identifier, with bit 31 for the extended kind: `CanFrame.key`."""
        return self.identifier | self.is_extended << 31


def parse_dbc(text: str, name: str) -> dict[str, Message]:
    """Return the messages of a DBC text by name.

    Args:
        text: the file's content.
        name: what to call it in an error.

    Raises:
        UsageError: it is too large, has no message, or a line that cannot be read.
    """
    if len(text) > MAX_TEXT_BYTES:
        raise UsageError(
            f"{name} is larger than {MAX_TEXT_BYTES >> 20} MB",
            "keep the IMU's messages alone in it",
        )
    messages: dict[str, Message] = {}
    by_id: dict[int, Message] = {}
    current: Message | None = None
    for number, line in enumerate(text.splitlines(), 1):
        where = f"{name} line {number}"
        if line.startswith("BO_ "):
            current = _message(line, where)
            if current.name in messages or current.key in by_id:
                raise UsageError(
                    f"{where}: a second message of the name {current.name} or its identifier",
                    "take one of them out",
                )
            messages[current.name] = by_id[current.key] = current
        elif line.lstrip().startswith("SG_ ") and current is not None:
            signal = _signal(line, where)
            if signal is not None:
                current.signals[signal.name] = signal
        elif line.startswith("SIG_VALTYPE_ "):
            _mark_float(line, where, by_id)
        elif line.strip():
            current = None  # SG_ elsewhere belongs to no message
    if not messages:
        raise UsageError(
            f"{name} describes no CAN message", "give one with lines that begin with BO_"
        )
    for message in messages.values():
        _check_bits(message, name)
    return messages


def _message(line: str, where: str) -> Message:
    match = _MESSAGE.match(line)
    if match is None:
        raise UsageError(
            f"{where} is no message of a DBC file", "write it as BO_ 291 NAME: 8 SENDER"
        )
    key, length = int(match[1]), int(match[3])
    identifier = key & ~_EXTENDED
    if identifier >= 1 << (29 if key & _EXTENDED else 11):
        # Vector's own files hold signals of no message under such an identifier.
        identifier, key = identifier & 0x1FFF_FFFF, key | _EXTENDED
    return Message(match[2], identifier, bool(key & _EXTENDED), length, {})


def _signal(line: str, where: str) -> Signal | None:
    match = _SIGNAL.match(line.strip())
    if match is None:
        raise UsageError(
            f"{where} is no signal of a DBC file",
            'write it as SG_ NAME : 0|16@1- (0.01,0) [0|0] "deg/s" RECEIVER',
        )
    if match[2] is not None:
        return None  # multiplexed: an IMU's samples are not
    factor, offset, minimum, maximum = (float(match[at]) for at in (7, 8, 9, 10))
    length = int(match[4])
    if not 1 <= length <= 64 or factor == 0.0:
        raise UsageError(
            f"{where}: a signal of {length} bits and factor {factor:g}",
            "give it 1 to 64 bits and a factor that is not 0",
        )
    return Signal(
        name=match[1],
        start=int(match[3]),
        length=length,
        is_intel=match[5] == "1",
        is_signed=match[6] == "-",
        factor=factor,
        offset=offset,
        minimum=minimum,
        maximum=maximum,
        unit=match[11],
    )


def _mark_float(line: str, where: str, by_id: dict[int, Message]) -> None:
    match = _FLOAT.match(line)
    message = None if match is None else by_id.get(int(match[1]))
    if match is None or message is None or match[3] == "0":
        return
    signal = message.signals.get(match[2])
    if signal is None:
        return
    if signal.length != (32 if match[3] == "1" else 64):
        raise UsageError(
            f"{where}: signal {signal.name} is a floating-point number of {signal.length} bits",
            "give it 32 bits with the type 1, or 64 with the type 2",
        )
    message.signals[signal.name] = replace(signal, is_float=True)


def _check_bits(message: Message, name: str) -> None:
    for signal in message.signals.values():
        if signal.last_byte >= message.length:
            raise UsageError(
                f"{name}: signal {signal.name} ends in byte {signal.last_byte + 1} of message "
                f"{message.name}, which has {message.length}",
                "correct its start and length, or the message's length",
            )
