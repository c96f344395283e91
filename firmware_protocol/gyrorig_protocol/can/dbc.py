"""DBC parser: the messages and signals of a CAN database file.

What to use when: `parse_dbc` for the text of a file; `DbcSignal.raw_value` and
`DbcSignal.raw_value` to decode frames. The parser reads BO_, SG_ and SIG_VALTYPE_ (floats).
Multiplexed signals are left out. All other lines are skipped: nodes, comments, attributes and value
tables are not needed for a sample.

Source of the grammar: Vector's DBC file format documentation, version 1.0.5. The tests compare the
result with cantools, an independent reader.
"""

import re
import struct
from dataclasses import dataclass, replace

from gyrorig_protocol.can.can_frame import EXTENDED_MASK
from gyrorig_protocol.errors import UsageError

MAX_TEXT_BYTES = 4 << 20
_NUMBER_REGEX = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
_MESSAGE_PATTERN = re.compile(r"BO_\s+(\d{1,10})\s+(\w{1,128})\s*:\s*(\d{1,4})\s")
_SIGNAL_PATTERN = re.compile(
    rf"SG_\s+(\w{{1,128}})\s*(M|m\d+M?)?\s*:\s*(\d{{1,3}})\|(\d{{1,2}})@([01])([-+])"
    rf"\s*\(\s*{_NUMBER_REGEX}\s*,\s*{_NUMBER_REGEX}\s*\)\s*\[\s*{_NUMBER_REGEX}\s*\|\s*{_NUMBER_REGEX}\s*\]"
    r'\s*"([^"]{0,64})"'
)
_FLOAT_PATTERN = re.compile(r"SIG_VALTYPE_\s+(\d{1,10})\s+(\w{1,128})\s*:?\s*([012])\s*;")
_EXTENDED = 1 << 31
_FLOAT_FORMATS = {(32, True): "<f", (32, False): ">f", (64, True): "<d", (64, False): ">d"}


@dataclass(frozen=True, slots=True)
class DbcSignal:
    """One signal of a message: the position of its bits, its scale and its unit."""

    name: str
    start_bit: int  # as in the file: the lowest bit in Intel order, the highest in Motorola order
    bit_length: int
    is_intel: bool  # little-endian
    is_signed: bool
    factor: float
    offset: float
    minimum: float  # minimum == maximum: the file has no range
    maximum: float
    unit: str
    is_float: bool = False

    @property
    def last_byte_index(self) -> int:
        """The index of the last byte of the frame that the signal needs."""
        if self.is_intel:
            return (self.start_bit + self.bit_length - 1) // 8
        return (self._msb_position() + self.bit_length - 1) // 8

    def raw_value(self, data: bytes) -> int | float:
        """Return the bits as an unscaled number; `data` must have byte `last_byte_index`."""
        mask = (1 << self.bit_length) - 1
        if self.is_intel:
            bits = int.from_bytes(data, "little") >> self.start_bit & mask
        else:
            trailing_bits = 8 * len(data) - self._msb_position() - self.bit_length
            bits = int.from_bytes(data, "big") >> trailing_bits & mask
        if self.is_float:
            number: float = struct.unpack(
                _FLOAT_FORMATS[self.bit_length, True], bits.to_bytes(self.bit_length // 8, "little")
            )[0]
            return number
        if self.is_signed and bits >> (self.bit_length - 1):
            bits -= 1 << self.bit_length
        return bits

    def _msb_position(self) -> int:
        """Return the position of the highest bit, from the first bit sent (Motorola order)."""
        return self.start_bit // 8 * 8 + 7 - self.start_bit % 8


@dataclass(frozen=True, slots=True)
class DbcMessage:
    """One message: its identifier and its signals by name."""

    name: str
    identifier: int
    is_extended: bool
    byte_length: int
    signals: dict[str, DbcSignal]

    @property
    def key(self) -> int:
        """The identifier with bit 31 set for an extended identifier, as `CanFrame.key`."""
        return self.identifier | self.is_extended << 31


def parse_dbc(text: str, name: str) -> dict[str, DbcMessage]:
    """Parse a DBC text and return its messages by name.

    Args:
        text: the file's content.
        name: the name of the file in an error.

    Raises:
        UsageError: it is too large, has no message, or has an invalid line.
    """
    if len(text) > MAX_TEXT_BYTES:
        raise UsageError(
            f"the DBC file {name} is larger than {MAX_TEXT_BYTES >> 20} MB",
            "remove all messages that the IMU does not send",
        )
    messages: dict[str, DbcMessage] = {}
    by_id: dict[int, DbcMessage] = {}
    current: DbcMessage | None = None
    for number, line in enumerate(text.splitlines(), 1):
        location = f"{name} line {number}"
        if line.startswith("BO_ "):
            current = _parse_message(line, location)
            if current.name in messages or current.key in by_id:
                raise UsageError(
                    f"{location} defines the message {current.name}, but its name or its "
                    "identifier is already in use",
                    "remove or rename one of the two messages",
                )
            messages[current.name] = by_id[current.key] = current
        elif line.lstrip().startswith("SG_ ") and current is not None:
            signal = _parse_signal(line, location)
            if signal is not None:
                current.signals[signal.name] = signal
        elif line.startswith("SIG_VALTYPE_ "):
            _mark_float(line, location, by_id)
        elif line.strip():
            current = None  # an SG_ after another line is not part of a message
    if not messages:
        raise UsageError(
            f"the DBC file {name} contains no CAN message",
            "give a DBC file that defines messages in lines that begin with BO_",
        )
    for message in messages.values():
        _check_bits(message, name)
    return messages


def _parse_message(line: str, location: str) -> DbcMessage:
    match = _MESSAGE_PATTERN.match(line)
    if match is None:
        raise UsageError(
            f"{location} is not a valid definition of a message in a DBC file",
            "write the message in the form BO_ 291 NAME: 8 SENDER",
        )
    key, length = int(match[1]), int(match[3])
    identifier = key & ~_EXTENDED
    if identifier >= 1 << (29 if key & _EXTENDED else 11):
        # Files of Vector have signals without a message under such an identifier.
        identifier, key = identifier & EXTENDED_MASK, key | _EXTENDED
    return DbcMessage(match[2], identifier, bool(key & _EXTENDED), length, {})


def _parse_signal(line: str, location: str) -> DbcSignal | None:
    match = _SIGNAL_PATTERN.match(line.strip())
    if match is None:
        raise UsageError(
            f"{location} is not a valid definition of a signal in a DBC file",
            'write the signal in the form SG_ NAME : 0|16@1- (0.01,0) [0|0] "deg/s" RECEIVER',
        )
    if match[2] is not None:
        return None  # multiplexed; samples of an IMU are not
    factor, offset, minimum, maximum = (float(match[group]) for group in (7, 8, 9, 10))
    bit_length = int(match[4])
    if not 1 <= bit_length <= 64 or factor == 0.0:
        raise UsageError(
            f"{location} defines a signal with an invalid length ({bit_length} bits) or an "
            f"invalid factor ({factor:g})",
            "give the signal 1 to 64 bits and a factor that is not 0",
        )
    return DbcSignal(
        name=match[1],
        start_bit=int(match[3]),
        bit_length=bit_length,
        is_intel=match[5] == "1",
        is_signed=match[6] == "-",
        factor=factor,
        offset=offset,
        minimum=minimum,
        maximum=maximum,
        unit=match[11],
    )


def _mark_float(line: str, location: str, by_id: dict[int, DbcMessage]) -> None:
    match = _FLOAT_PATTERN.match(line)
    message = None if match is None else by_id.get(int(match[1]))
    if match is None or message is None or match[3] == "0":
        return
    signal = message.signals.get(match[2])
    if signal is None:
        return
    if signal.bit_length != (32 if match[3] == "1" else 64):
        raise UsageError(
            f"{location} gives the signal {signal.name} the floating-point type {match[3]}, but "
            f"the signal has {signal.bit_length} bits",
            "in the line SIG_VALTYPE_, write 1 for a signal of 32 bits, or 2 for a signal of 64 "
            "bits",
        )
    message.signals[signal.name] = replace(signal, is_float=True)


def _check_bits(message: DbcMessage, name: str) -> None:
    for signal in message.signals.values():
        if signal.last_byte_index >= message.byte_length:
            raise UsageError(
                f"in the DBC file {name}, the signal {signal.name} ends in byte "
                f"{signal.last_byte_index + 1}, but its message {message.name} has only "
                f"{message.byte_length} bytes",
                "correct the start or the length of the signal, or the length of the message",
            )
