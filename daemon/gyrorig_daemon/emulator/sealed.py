"""A truth that nobody can look at, and nobody can change, before the work is done.

At the start only the SHA-256 of what is hidden is told; a nonce keeps it from being guessed.
At the end the truth is opened, and everyone can compute the sum again from its `hidden`.
"""

import hashlib
import json
import secrets
from collections.abc import Mapping
from typing import Any

_HOW = "SHA-256 of `hidden` as JSON with sorted keys and no spaces, UTF-8"


class Seal:
    """One sealed truth."""

    def __init__(self, document: Mapping[str, Any]) -> None:
        """Seal what a truth document hides."""
        self._hidden = {**document["hidden"], "nonce": secrets.token_hex(16)}
        self.sha256 = digest(self._hidden)

    def closed(self) -> dict[str, Any]:
        """Return what may be told at the start."""
        return {"seal": {"sha256": self.sha256, "of": _HOW}}

    def opened(self, document: Mapping[str, Any]) -> dict[str, Any]:
        """Return the truth document with what was sealed, and its seal."""
        return {**document, "hidden": self._hidden, **self.closed()}


def digest(hidden: Mapping[str, Any]) -> str:
    """Return the SHA-256 of what a truth hides, in hexadecimal."""
    text = json.dumps(hidden, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
