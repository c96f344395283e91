"""Protocol of the service's socket: one JSON object per line, in both directions.

    -> {"command": "status"}                       <- {"ok": true, "status": {...}}
    -> {"command": "watch"}                        <- the same now, and then every second
    -> {"command": "halt"}                         <- {"ok": true, "said": "..."}
    -> {"command": "clear"} {"command": "reload"}  <- {"ok": true, "said": "..."}
    -> anything else                               <- {"ok": false, "error": "..."}

`status`, `watch` and `halt` are for everyone who can access the socket's folder, because
stopping a machine needs no further permission. Commands that permit motion or change the
configuration are for root and the service's own user.
"""

import json
from typing import Any

DEFAULT_SOCKET = "/run/gyrorig/gyrorigd.sock"
SOCKET_NAME = "gyrorigd.sock"
MAX_REQUEST_BYTES = 4_096
MAX_RESPONSE_BYTES = 1_000_000
QUERY_COMMANDS = frozenset({"status", "watch"})
HALT_COMMANDS = frozenset({"halt"})
PRIVILEGED_COMMANDS = frozenset({"clear", "reload"})


def encode(document: dict[str, Any]) -> bytes:
    """Return a document as one line."""
    return json.dumps(document, separators=(",", ":")).encode() + b"\n"


def decode_request(line: bytes) -> str | None:
    """Return the command in an untrusted line, None if it is not a valid request."""
    try:
        document = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(document, dict) or set(document) != {"command"}:
        return None
    command = document["command"]
    commands = QUERY_COMMANDS | HALT_COMMANDS | PRIVILEGED_COMMANDS
    return command if isinstance(command, str) and command in commands else None
