"""The other end of the socket: ask a running daemon, or watch it."""

import json
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gyrorig_daemon.service.wire import MAX_ANSWER_BYTES, encode
from gyrorig_protocol.errors import GyrorigError, MachineError

PATIENCE_S = 5.0
LOG = "`journalctl -u gyrorigd` says why, or the terminal in which it ran"
_READ_BYTES = 65_536


class RefusedRequestError(GyrorigError):
    """The daemon is there and says no.

    Example: an ordinary user asks it to clear a fault.
    """


def ask(path: Path, command: str) -> dict[str, Any]:
    """Return the daemon's answer to one command.

    Raises:
        MachineError: no daemon answers there.
        RefusedRequestError: it says no.
    """
    return next(listen(path, command))


def listen(path: Path, command: str) -> Iterator[dict[str, Any]]:
    """Yield the daemon's answers for as long as it goes on.

    Raises:
        MachineError: no daemon answers there, or it went away.
        RefusedRequestError: it says no.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC) as connection:
        connection.settimeout(PATIENCE_S)
        try:
            connection.connect(str(path))
            connection.sendall(encode({"command": command}))
            for line in _lines(connection):
                yield _read(line, path)
        except TimeoutError as fault:
            raise MachineError(
                f"the daemon at {path} does not answer within {PATIENCE_S:.0f} s", LOG
            ) from fault
        except OSError as fault:
            raise MachineError(
                f"no daemon answers at {path}: {fault.strerror or fault}",
                "start `gyrorigd run`, join its group, or name its socket with --socket",
            ) from fault
    raise MachineError(f"the daemon at {path} went away", LOG)


def _lines(connection: socket.socket) -> Iterator[bytes]:
    held = bytearray()
    while data := connection.recv(_READ_BYTES):
        held += data
        while (end := held.find(b"\n")) >= 0:
            yield bytes(held[:end])
            del held[: end + 1]
        if len(held) > MAX_ANSWER_BYTES:
            return


def _read(line: bytes, path: Path) -> dict[str, Any]:
    try:
        document = json.loads(line)
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict):
        raise MachineError(f"what answers at {path} is no gyrorigd", "name its socket by --socket")
    if document.get("ok") is not True:
        raise RefusedRequestError(str(document.get("error", "the daemon refuses")))
    return document
