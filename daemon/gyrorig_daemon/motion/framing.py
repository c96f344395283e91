"""How the words of a unit become bytes on its line, and bytes become words.

What to use when: nothing of this for a unit of text lines, because `LineFraming` is the default of
`TextLanguage`. For a unit of binary frames, write a class with the members of `Framing` and name
it in `TextLanguage.framing`. The words are then a readable form of the frames, for example
`SEEK 0 12500`. Every line makes its own object, so that a framing can count its frames.
"""

from typing import Protocol

MAX_REPLY_BYTES = 512
_LINE_ENDS = b"\r\n"


class Framing(Protocol):
    """Translates between words and bytes.

    Attributes:
        halt_prefix: bytes that end a truncated command; they are sent before the halt command.
    """

    @property
    def halt_prefix(self) -> bytes: ...  # noqa: D102 - see Attributes

    def encode(self, text: str) -> bytes:
        """Return the bytes of a command."""
        ...

    def decode(self, received: bytearray) -> str | None:
        """Remove the first complete reply from `received` and return its words.

        Bytes that belong to no reply are removed, too. A reply to an earlier command can be
        removed and ignored if the frames are numbered.

        Returns:
            The words of the reply; None if more bytes must arrive first.

        Raises:
            ValueError: the reply is damaged. Its bytes were removed.
        """
        ...


class LineFraming:
    """Lines of ASCII text. A command ends with `line_end`, a reply with CR or LF or both."""

    def __init__(self, line_end: str) -> None:
        """Translate lines; see `Framing`."""
        self._line_end = line_end.encode("ascii")
        self.halt_prefix = self._line_end

    def encode(self, text: str) -> bytes:
        """See `Framing`."""
        return text.encode("ascii") + self._line_end

    def decode(self, received: bytearray) -> str | None:
        """See `Framing`; empty lines are ignored."""
        while received:
            end = next((k for k, byte in enumerate(received) if byte in _LINE_ENDS), None)
            if end is None:
                return None
            line = bytes(received[:end]).strip()
            del received[: end + 1]
            if line:
                return line.decode("ascii")
        return None


def decode_replies(framing: Framing, received: bytearray) -> tuple[list[str], int]:
    """Take all complete replies out of `received`.

    Returns:
        The words of each reply, and the number of damaged replies. More than `MAX_REPLY_BYTES`
        bytes without a complete reply count as one damaged reply.
    """
    replies: list[str] = []
    damaged_count = 0
    while received:
        before_bytes = len(received)
        try:
            text = framing.decode(received)
        except ValueError:
            damaged_count += 1
            text = None
        else:
            if text is None:
                break
            replies.append(text)
        if len(received) >= before_bytes:
            raise AssertionError("a framing has not removed the reply from the received bytes")
    if len(received) > MAX_REPLY_BYTES:
        received.clear()
        damaged_count += 1
    return replies, damaged_count
