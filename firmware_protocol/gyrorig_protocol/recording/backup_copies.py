"""Backup copies of a recording's metadata and channels, with a checksum.

What to use when: the writer adds the copies as attachments; the reader uses them if the originals
are damaged. MCAP metadata records have no checksum. A channel is declared only in the chunk of its
first message and in the summary; without that chunk, the messages of an unfinished file would have
no names. Attachments have a checksum, and other readers ignore these.
"""

import json
from collections.abc import Iterable, Mapping
from typing import Any

from gyrorig_protocol.recording.encoding.message_schemas import SCHEMAS
from gyrorig_protocol.recording.mcap.declarations import (
    ChannelDeclaration,
    Declarations,
    SchemaDeclaration,
)
from gyrorig_protocol.recording.mcap.record_scan import AttachmentRecord

METADATA_COPY = "gyrorig.metadata.json"
CHANNELS_COPY = "gyrorig.channels.json"
COPY_NAMES = frozenset({METADATA_COPY, CHANNELS_COPY})
COPY_MEDIA_TYPE = "application/json"
_MAX_CHANNEL_DIGITS = 5  # a channel number has 16 bits

Metadata = dict[str, dict[str, str]]


def encode_metadata_copy(metadata: Mapping[str, Mapping[str, str]]) -> bytes:
    """Return the content of the copy of the metadata."""
    return json.dumps(metadata).encode()


def encode_channels_copy(channels: Mapping[int, tuple[str, str]]) -> bytes:
    """Return the content of the copy of the channels: number -> (topic, type)."""
    return json.dumps({str(number): channel for number, channel in channels.items()}).encode()


def read_metadata_copy(attachments: Iterable[AttachmentRecord]) -> Metadata:
    """Return the metadata of the copy; empty without a copy."""
    metadata: Metadata = {}
    for content in _copy_contents(attachments, METADATA_COPY):
        if all(_is_text_map(record) for record in content.values()):
            metadata = {name: dict(record) for name, record in content.items()}
    return metadata


def read_channels_copy(attachments: Iterable[AttachmentRecord]) -> Declarations:
    """Return the channels of all copies, with the schemas of format 1."""
    declarations = Declarations()
    for content in _copy_contents(attachments, CHANNELS_COPY):
        for number, channel in content.items():
            if not number.isdecimal() or len(number) > _MAX_CHANNEL_DIGITS:
                continue
            match channel:
                case [str(topic), str(type_name)] if type_name in SCHEMAS:
                    # Negative numbers do not clash with the schema numbers of the file.
                    declarations.channels[int(number)] = ChannelDeclaration(
                        topic, "cdr", -int(number)
                    )
                    schema = SchemaDeclaration(type_name, "ros2msg", SCHEMAS[type_name].encode())
                    declarations.schemas[-int(number)] = schema
    return declarations


def _copy_contents(attachments: Iterable[AttachmentRecord], name: str) -> list[dict[str, Any]]:
    contents = []
    for attachment in attachments:
        if attachment.name == name:
            try:
                content = json.loads(attachment.data)
            except (ValueError, RecursionError):
                continue
            if isinstance(content, dict):
                contents.append(content)
    return contents


def _is_text_map(record: object) -> bool:
    return isinstance(record, dict) and all(isinstance(value, str) for value in record.values())
