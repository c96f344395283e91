"""Metadata and attachments at the beginning of a recording.

What to use when: `Attachment` for a file inside a recording; `software_version` for the name and
version of this program; `recording_order` to sort files; `complete_metadata` only in the writer.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

FORMAT_VERSION = "1"
_PART_NAME = re.compile(r"(.*)_p(\d{3,})\.mcap")
_REQUIRED_KEYS = ("session", "anchor_utc_ns", "anchor_monotonic_raw_ns")


@cache  # the query is slower than writing a small file
def software_version() -> str:
    """Return `gyrorig <version>`, as in the file's header and metadata."""
    try:
        return f"gyrorig {version('gyrorig')}"
    except PackageNotFoundError:
        return "gyrorig unknown"


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file inside a recording."""

    name: str
    media_type: str
    data: bytes
    log_time_ns: int = 0


def recording_order(path: Path) -> tuple[str, int, str]:
    """Return the sort key of a file: by name, and the parts of a session by number.

    Sorted by name alone, `_p1000` precedes `_p101`.
    """
    match = _PART_NAME.match(path.name)
    if match is None:
        return path.name.partition(".mcap")[0], 0, path.name
    return match[1], int(match[2]), path.name


def complete_metadata(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, dict[str, str]]:
    """Check the metadata and add the keys that the writer knows.

    Raises:
        ValueError: a required key is missing, or a key or value is not text.
    """
    records = {name: dict(record) for name, record in metadata.items()}
    for name, record in records.items():
        for key, value in record.items():
            if not isinstance(key, str) or not isinstance(value, str):
                raise ValueError(f"metadata {name}: {key!r}: {value!r} is not text")
    main_record = records.get("gyrorig", {})
    missing_keys = [key for key in _REQUIRED_KEYS if key not in main_record]
    if missing_keys:
        raise ValueError(f"metadata gyrorig lacks {', '.join(missing_keys)}")
    main_record = {
        "format": FORMAT_VERSION,
        "software": software_version(),
        "part": "0",
        "previous": "",
    } | main_record
    if main_record["format"] != FORMAT_VERSION:
        raise ValueError(
            f"this program writes format {FORMAT_VERSION}, not {main_record['format']}"
        )
    records["gyrorig"] = main_record
    if "rig" in main_record:
        records.setdefault("foxglove", {"deviceName": main_record["rig"]})
    return records
