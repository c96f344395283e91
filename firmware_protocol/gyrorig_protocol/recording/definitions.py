"""Schemas and channels of a file, and which of several copies to believe.

What to use when: under `framing`, `chunks` and `reader`. Copies inside chunks and in
a summary with a right checksum are believed; copies in the open data section carry no
checksum and serve only where there is no other.
"""

from dataclasses import dataclass, field

from gyrorig_protocol.recording.fields import Fields, MalformedError


@dataclass(frozen=True, slots=True)
class Schema:
    """A Schema record."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Channel:
    """A Channel record."""

    topic: str
    encoding: str
    schema_id: int


@dataclass(slots=True)
class Declared:
    """Schemas and channels by number.

    Raises:
        MalformedError: a record is damaged, or gives a number a second meaning.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)

    def add_schema(self, fields: Fields) -> None:
        """Take in a Schema record."""
        number = fields.number(2)
        schema = Schema(fields.text(), fields.text(), fields.raw(4))
        fields.done()
        if self.schemas.setdefault(number, schema) != schema:
            raise MalformedError(f"schema {number} is declared twice, differently")

    def add_channel(self, fields: Fields) -> None:
        """Take in a Channel record."""
        number, schema_id = fields.number(2), fields.number(2)
        channel = Channel(fields.text(), fields.text(), schema_id)
        fields.text_map()
        fields.done()
        if self.channels.setdefault(number, channel) != channel:
            raise MalformedError(f"channel {number} is declared twice, differently")

    def fill_from(self, other: "Declared") -> None:
        """Take over what is not known yet."""
        self.schemas = other.schemas | self.schemas
        self.channels = other.channels | self.channels
