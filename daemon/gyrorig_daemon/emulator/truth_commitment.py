"""Cryptographic commitment to the injected causes: secret until the end, and not changeable.

At the start only the SHA-256 of the injected causes is published; a nonce prevents guessing. At the
end the truth is revealed, and everyone can compute the digest of its `hidden` again.
"""

import hashlib
import json
import secrets
from collections.abc import Mapping
from typing import Any

_DIGEST_METHOD = "SHA-256 of `hidden` as JSON with sorted keys and no spaces, UTF-8"


class TruthCommitment:
    """Commitment to one truth document."""

    def __init__(self, document: Mapping[str, Any]) -> None:
        """Commit to the injected causes of a truth document."""
        self._injected = {**document["hidden"], "nonce": secrets.token_hex(16)}
        self.sha256 = truth_digest(self._injected)

    def commitment_document(self) -> dict[str, Any]:
        """Return the commitment, which is published at the start."""
        return {"seal": {"sha256": self.sha256, "of": _DIGEST_METHOD}}

    def revealed_document(self, document: Mapping[str, Any]) -> dict[str, Any]:
        """Return the truth document with the injected causes, the nonce and the commitment."""
        return {**document, "hidden": self._injected, **self.commitment_document()}


def truth_digest(injected: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the injected causes, in hexadecimal."""
    text = json.dumps(injected, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
