"""The protocols by name: every module of this package that has a `PROTOCOL`.

Extensions are in `gyrorig_extensions/board_protocols`, see `module_registry`.
"""

from functools import cache

from gyrorig_protocol import board_protocols
from gyrorig_protocol.board_protocols.board_protocol import (
    BoardProtocol,
    CanProtocol,
    SerialProtocol,
)
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.module_registry import registered_modules
from gyrorig_protocol.suggestions import did_you_mean


@cache
def _protocols() -> dict[tuple[str, bool], BoardProtocol]:
    """Return each protocol by its name, and whether it is one of a bus."""
    protocols: dict[tuple[str, bool], BoardProtocol] = {}
    for module in registered_modules(board_protocols, "board_protocols"):
        protocol: BoardProtocol | None = getattr(module, "PROTOCOL", None)
        if protocol is not None:
            protocols[protocol.name, protocol.on_bus] = protocol
    return protocols


def protocol_names(on_bus: bool) -> tuple[str, ...]:
    """Return the names of the protocols of a serial port, or of a CAN bus."""
    return tuple(name for name, is_of_bus in _protocols() if is_of_bus == on_bus)


def find_protocol(name: str, on_bus: bool = False, owner: str = "a board") -> BoardProtocol:
    """Return the protocol with a name, on a serial port or on a CAN bus.

    Args:
        name: the value of `format` in a rig file.
        on_bus: on a CAN bus.
        owner: of the name, for an error.

    Raises:
        UsageError: there is no such protocol there.
    """
    protocol = _protocols().get((name, on_bus))
    if protocol is not None:
        return protocol
    names = protocol_names(on_bus)
    listed = f"use {' or '.join(f'`format: {known}`' for known in names)}"
    if (name, not on_bus) not in _protocols():
        problem = f"{owner} has `format: {name}`, which is not a known protocol"
        raise UsageError(problem, did_you_mean(name, names) or listed)
    if on_bus:
        problem = f"{owner} has `format: {name}`, which a CAN bus does not support"
        raise UsageError(problem, listed)
    problem = f"{owner} has `format: {name}`, which needs a CAN bus"
    raise UsageError(problem, f"replace the key `port` by the key `bus`, or {listed}")


def find_serial_protocol(name: str) -> SerialProtocol:
    """Return a protocol of a serial port; errors as in `find_protocol`."""
    protocol = find_protocol(name)
    if not isinstance(protocol, SerialProtocol):
        raise TypeError(f"{name} is not a protocol of a serial port")
    return protocol


def find_can_protocol(name: str) -> CanProtocol:
    """Return a protocol of a CAN bus; errors as in `find_protocol`."""
    protocol = find_protocol(name, on_bus=True)
    if not isinstance(protocol, CanProtocol):
        raise TypeError(f"{name} is not a protocol of a CAN bus")
    return protocol
