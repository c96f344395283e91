"""Times in documents and in the index, as UTC text: `2026-01-31T02:30:00Z`."""

from datetime import UTC, datetime
from typing import Final

TIME_FORMAT: Final = "%Y-%m-%dT%H:%M:%SZ"


def utc_text(nanoseconds: int) -> str:
    """Return nanoseconds since the epoch as text."""
    return datetime.fromtimestamp(nanoseconds // 1_000_000_000, UTC).strftime(TIME_FORMAT)


def utc_text_now() -> str:
    """Return the present time as text."""
    return datetime.now(UTC).strftime(TIME_FORMAT)


def parse_utc_text(text: str) -> datetime:
    """Return the time that a text gives.

    Raises:
        ValueError: the text is not such a time.
    """
    return datetime.strptime(text, TIME_FORMAT).replace(tzinfo=UTC)
