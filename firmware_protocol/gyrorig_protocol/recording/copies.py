"""Second copies, with a checksum, of what a recording cannot do without.

What to use when: `writer` puts them in as attachments, `reader` falls back on them.
MCAP gives metadata records no checksum, and declares a channel only in the chunk of its
first message and in the summary: an unfinished file that loses that chunk could not
name the rest of its messages. An attachment has a checksum, and any other reader
ignores these.
"""

import json
from collections.abc import Iterable, Mapping
from typing import Any

from gyrorig_protocol.recording.definitions import Channel, Declared, Schema
from gyrorig_protocol.recording.framing import AttachmentRecord
from gyrorig_protocol.recording.schemas import SCHEMAS

METADATA_COPY = "gyrorig.metadata.json"
CHANNELS_COPY = "gyrorig.channels.json"
NAMES = frozenset({METADATA_COPY, CHANNELS_COPY})
MEDIA_TYPE = "application/json"
_MAX_DIGITS = 5  # a channel's number takes 16 bits

Metadata = dict[str, dict[str, str]]


def metadata_copy(metadata: Mapping[str, Mapping[str, str]]) -> bytes:
    """The content of the metadata's copy."""
    return json.dumps(metadata).encode()


def channels_copy(channels: Mapping[int, tuple[str, str]]) -> bytes:
    """The content of the channels' copy: number -> (topic, type)."""
    return json.dumps({str(number): channel for number, channel in channels.items()}).encode()


def read_metadata(attachments: Iterable[AttachmentRecord]) -> Metadata:
    """The metadata of the copy; empty without one."""
    found: Metadata = {}
    for content in _contents(attachments, METADATA_COPY):
        if all(_is_text_map(record) for record in content.values()):
            found = {name: dict(record) for name, record in content.items()}
    return found


def read_channels(attachments: Iterable[AttachmentRecord]) -> Declared:
    """The channels of all copies, with the schemas of format 1."""
    found = Declared()
    for content in _contents(attachments, CHANNELS_COPY):
        for number, channel in content.items():
            if not number.isdecimal() or len(number) > _MAX_DIGITS:
                continue
            match channel:
                case [str(topic), str(kind)] if kind in SCHEMAS:
                    # Schema numbers of the file are not negative.
                    found.channels[int(number)] = Channel(topic, "cdr", -int(number))
                    schema = Schema(kind, "ros2msg", SCHEMAS[kind].encode())
                    found.schemas[-int(number)] = schema
    return found


def _contents(attachments: Iterable[AttachmentRecord], name: str) -> list[dict[str, Any]]:
    found = []
    for attachment in attachments:
        if attachment.name == name:
            try:
                content = json.loads(attachment.data)
            except (ValueError, RecursionError):
                continue
            if isinstance(content, dict):
                found.append(content)
    return found


def _is_text_map(record: object) -> bool:
    return isinstance(record, dict) and all(isinstance(value, str) for value in record.values())
