"""Client of the service's socket: send a command to a running service, or watch its status."""

import contextlib
import json
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gyrorig_daemon.service.service_protocol import MAX_RESPONSE_BYTES, encode
from gyrorig_protocol.errors import GyrorigError, MachineError

RESPONSE_TIMEOUT_S = 5.0
CONNECT_RETRY_S = 0.02
LOG_HINT = (
    "read the daemon's messages with `journalctl -u gyrorigd`, or in the terminal in which it ran"
)
_READ_BYTES = 65_536


class RefusedRequestError(GyrorigError):
    """The service rejected a request.

    Example: an ordinary user requests `clear`.
    """


def send_command(path: Path, command: str) -> dict[str, Any]:
    """Return the service's response to one command.

    Raises:
        MachineError: no service answers.
        RefusedRequestError: the service rejected the command.
    """
    return next(stream_responses(path, command))


def stream_responses(path: Path, command: str) -> Iterator[dict[str, Any]]:
    """Yield the service's responses to one command, until the connection ends.

    Raises:
        MachineError: no service answers, or the connection ended.
        RefusedRequestError: the service rejected the command.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC) as connection:
        connection.settimeout(RESPONSE_TIMEOUT_S)
        try:
            _connect(connection, path)
            with contextlib.suppress(BrokenPipeError):  # refused: the reason can be read
                connection.sendall(encode({"command": command}))
            for line in _read_lines(connection):
                yield _parse_response(line, path)
        except TimeoutError as error:
            raise MachineError(
                f"the daemon at the socket {path} did not answer within {RESPONSE_TIMEOUT_S:.0f} s",
                LOG_HINT,
            ) from error
        except OSError as error:
            raise _connection_error(path, error) from error
    raise MachineError(f"the daemon closed the connection at the socket {path}", LOG_HINT)


def _connect(connection: socket.socket, path: Path) -> None:
    """Connect, and try again while others fill the row of those who wait to be accepted."""
    end_s = time.monotonic() + RESPONSE_TIMEOUT_S
    while True:
        try:
            connection.connect(str(path))
        except BlockingIOError:
            if time.monotonic() > end_s:
                raise
            time.sleep(CONNECT_RETRY_S)
        else:
            return


def _connection_error(path: Path, error: OSError) -> MachineError:
    if isinstance(error, FileNotFoundError | ConnectionRefusedError):
        return MachineError(
            f"no daemon is running at the socket {path}",
            "start the daemon with `gyrorigd run`, or give its socket with --socket",
        )
    return MachineError(
        f"the command cannot connect to the daemon at the socket {path} "
        f"({error.strerror or error})",
        "use sudo, or join the group of the daemon with `sudo usermod -aG gyrorig $USER`",
    )


def _read_lines(connection: socket.socket) -> Iterator[bytes]:
    buffer = bytearray()
    while data := connection.recv(_READ_BYTES):
        buffer += data
        while (end := buffer.find(b"\n")) >= 0:
            yield bytes(buffer[:end])
            del buffer[: end + 1]
        if len(buffer) > MAX_RESPONSE_BYTES:
            return


def _parse_response(line: bytes, path: Path) -> dict[str, Any]:
    try:
        document = json.loads(line)
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict):
        raise MachineError(
            f"the program that answers at the socket {path} is not gyrorigd",
            "give the socket of the daemon with --socket",
        )
    if document.get("ok") is not True:
        raise RefusedRequestError(str(document.get("error", "the daemon rejected the request")))
    return document
