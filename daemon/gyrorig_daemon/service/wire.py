"""The words of the local socket: one JSON object a line, both ways.

    -> {"command": "status"}                       <- {"ok": true, "status": {...}}
    -> {"command": "watch"}                        <- the same at once, then every second
    -> {"command": "halt"}                         <- {"ok": true, "said": "..."}
    -> {"command": "clear"} {"command": "reload"}  <- {"ok": true, "said": "..."}
    -> anything else                               <- {"ok": false, "error": "..."}

`status`, `watch` and `halt` are for everyone whom the socket's folder lets in: bringing a
machine to rest needs no further right. What lets it move, or changes what it does, is for
root and for the daemon's own user.
"""

import json
from typing import Any

DEFAULT_SOCKET = "/run/gyrorig/gyrorigd.sock"
SOCKET_NAME = "gyrorigd.sock"
MAX_REQUEST_BYTES = 4_096
MAX_ANSWER_BYTES = 1_000_000
READING = frozenset({"status", "watch"})
HALTING = frozenset({"halt"})
COMMANDING = frozenset({"clear", "reload"})


def encode(document: dict[str, Any]) -> bytes:
    """Return one line."""
    return json.dumps(document, separators=(",", ":")).encode() + b"\n"


def decode_request(line: bytes) -> str | None:
    """Return the command of a line that anybody may have sent, None where it is none."""
    try:
        document = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(document, dict) or set(document) != {"command"}:
        return None
    command = document["command"]
    known = READING | HALTING | COMMANDING
    return command if isinstance(command, str) and command in known else None
