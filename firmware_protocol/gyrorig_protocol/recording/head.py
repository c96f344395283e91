"""What stands at the beginning of a recording: metadata and attachments.

What to use when: `Attachment` to carry a file, `software` to name this program;
`complete_metadata` is the writer's.

Source: the recording contract, format 1, section "Metadata records".
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version

FORMAT = "1"
_REQUIRED = ("session", "anchor_utc_ns", "anchor_monotonic_raw_ns")


@cache  # asking takes longer than writing a small file
def software() -> str:
    """`gyrorig <version>`, as the file's library and metadata name it."""
    try:
        return f"gyrorig {version('gyrorig')}"
    except PackageNotFoundError:
        return "gyrorig unknown"


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file carried inside a recording."""

    name: str
    media_type: str
    data: bytes
    log_time_ns: int = 0


def complete_metadata(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, dict[str, str]]:
    """Check the metadata against the contract and fill in what the writer knows.

    Raises:
        ValueError: a required key is missing, or something is not text.
    """
    records = {name: dict(record) for name, record in metadata.items()}
    for name, record in records.items():
        for key, value in record.items():
            if not isinstance(key, str) or not isinstance(value, str):
                raise ValueError(f"metadata {name}: {key!r}: {value!r} is not text")
    own = records.get("gyrorig", {})
    missing = [key for key in _REQUIRED if key not in own]
    if missing:
        raise ValueError(f"metadata gyrorig lacks {', '.join(missing)}")
    own = {"format": FORMAT, "software": software(), "part": "0", "previous": ""} | own
    if own["format"] != FORMAT:
        raise ValueError(f"this writes format {FORMAT}, not {own['format']}")
    records["gyrorig"] = own
    if "rig" in own:
        records.setdefault("foxglove", {"deviceName": own["rig"]})
    return records
