"""Schemas and channels that a file declares.

Declarations in chunks, and in a summary with a valid checksum, are trusted. Declarations in the
data section outside chunks have no checksum; they are used only if there is no other.
"""

from dataclasses import dataclass, field

from gyrorig_protocol.recording.mcap.record_cursor import MalformedError, RecordCursor


@dataclass(frozen=True, slots=True)
class SchemaDeclaration:
    """A Schema record."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class ChannelDeclaration:
    """A Channel record."""

    topic: str
    encoding: str
    schema_id: int


@dataclass(slots=True)
class Declarations:
    """Schemas and channels by number.

    Raises:
        MalformedError: a record is damaged, or declares a number twice with different content.
    """

    schemas: dict[int, SchemaDeclaration] = field(default_factory=dict)
    channels: dict[int, ChannelDeclaration] = field(default_factory=dict)

    def add_schema(self, cursor: RecordCursor) -> None:
        """Add a Schema record."""
        number = cursor.read_uint(2)
        schema = SchemaDeclaration(cursor.read_text(), cursor.read_text(), cursor.read_bytes(4))
        cursor.check_end()
        if self.schemas.setdefault(number, schema) != schema:
            raise MalformedError(f"schema {number} is declared twice with different content")

    def add_channel(self, cursor: RecordCursor) -> None:
        """Add a Channel record."""
        number, schema_id = cursor.read_uint(2), cursor.read_uint(2)
        channel = ChannelDeclaration(cursor.read_text(), cursor.read_text(), schema_id)
        cursor.read_text_map()
        cursor.check_end()
        if self.channels.setdefault(number, channel) != channel:
            raise MalformedError(f"channel {number} is declared twice with different content")

    def add_missing_from(self, other: "Declarations") -> None:
        """Add the declarations of `other` that are missing here."""
        self.schemas = other.schemas | self.schemas
        self.channels = other.channels | self.channels
