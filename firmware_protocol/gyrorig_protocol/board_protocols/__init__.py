"""The protocols that boards speak, one per file: parser, requests, and what a rig file must say.

To add a protocol, add a file with a `PROTOCOL` here, and its other end for emulated boards in
`gyrorig_daemon/emulator/board/protocols`.

What to use when: `find_protocol` for the `format` of a board in a rig file.
"""

from gyrorig_protocol.board_protocols.board_protocol import (
    BoardEntry,
    BoardProtocol,
    CanParser,
    CanProtocol,
    SerialParser,
    SerialProtocol,
)
from gyrorig_protocol.board_protocols.protocol_registry import (
    find_can_protocol,
    find_protocol,
    find_serial_protocol,
    protocol_names,
)

__all__ = [
    "BoardEntry",
    "BoardProtocol",
    "CanParser",
    "CanProtocol",
    "SerialParser",
    "SerialProtocol",
    "find_can_protocol",
    "find_protocol",
    "find_serial_protocol",
    "protocol_names",
]
