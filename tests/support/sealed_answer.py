"""The answer of a hidden session, with the digest that shows a later change.

What to use when: `seal` after a session was made, before any program searches it.
"""

import hashlib
import json
from pathlib import Path
from typing import Any


def seal(folder: Path, document: dict[str, Any]) -> str:
    """Write an answer and its digest; return the SHA-256 of the answer's bytes."""
    data = (json.dumps(document, indent=1, allow_nan=False) + "\n").encode()
    sealed = hashlib.sha256(data).hexdigest()
    (folder / "answer.json").write_bytes(data)
    (folder / "sealed.txt").write_text(sealed + "\n", encoding="ascii")
    return sealed
