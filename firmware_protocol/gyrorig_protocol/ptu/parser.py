r"""Split a pan-tilt unit's byte stream into events.

Theory of operation
-------------------
The replies of real units are not one grammar: echo on or off, verbose or terse, CR or
space delimiters, and limit flags glued in front of, or into the middle of, anything
(command reference manual v3.00D; clients of real units). So the work is done in two
layers that know nothing of commands:

1. Bytes to lines, one byte at a time, three states (`_TEXT`, `_BANG`, `_SKIP`):

       state   byte                 action                                next
       TEXT    !                    hold it back                          BANG
       TEXT    LF                   end the line                          TEXT
       TEXT    any, after a CR      end the line before it, then as TEXT  TEXT
       TEXT    any                  keep; over the limit: FrameError      TEXT / SKIP
       BANG    P, T, D              flag event, at once                   back
       BANG    any                  put the ! into the line, then as TEXT back
       SKIP    LF, or any after CR  forget the line                       TEXT
       SKIP    any                  drop                                  SKIP

   A flag is told at once, even inside an overlong line: it means that steps were lost.
   An error's `!` is followed by a space, so the two never meet. CR LF ends a line, LF
   alone does, and CR alone does as soon as the next byte shows that no LF follows. An
   empty line, such as the leading LF after a CR delimiter, says nothing.

2. Lines to events (`_classify`): echo, status mark, text. The rules are the tables
   `_COMMAND` and `_BANNER_WORDS`.

Contract: device bytes raise nothing. Whatever is no reply is a `FrameError` event; the
events do not depend on where the stream was cut; memory stays below `max_line_bytes`.
"""

import re

from gyrorig_protocol.ptu.events import (
    Axis,
    Banner,
    CableFlag,
    Echo,
    FrameError,
    FrameReason,
    LimitFlag,
    PtuEvent,
    Reply,
)

_LF, _CR, _BANG_MARK, _STAR_MARK = b"\n\r!*"
_LIMIT_AXES = {ord("P"): Axis.PAN, ord("T"): Axis.TILT}
_CABLE = ord("D")

# One or more commands: letters, then numbers, `B1,2,3,4`, `@(9600,0,F)`, `_0`, `?`.
_COMMAND = re.compile(r"(?:[A-Z]{1,4}|@|_|\?)[-+0-9.,()TF]*", re.IGNORECASE)
_BANNER_WORDS = re.compile(
    r"pan-tilt|directed perception|flir|rights reserved|\(c\)|copyright", re.IGNORECASE
)


class PtuReplyParser:
    """Split a unit's byte stream into replies, limit flags and the rest.

    Feed it whatever the port returned, in any pieces: device bytes raise nothing.
    """

    def __init__(self, max_line_bytes: int = 256) -> None:
        self._limit = max_line_bytes
        self._expected: str | None = None
        self.reset()

    @property
    def buffered_bytes(self) -> int:
        """How much of an unfinished line is held, at most `max_line_bytes`."""
        return len(self._line)

    def expect(self, command: str | None) -> None:
        """Say which command is in flight, so that the echo of another is told apart.

        Args:
            command: its text as sent; None accepts the echo of any command. With echo
                off it makes no difference.
        """
        self._expected = None if command is None else " ".join(command.upper().split())

    def reset(self) -> None:
        """Forget an unfinished line, as after draining the port."""
        self._line = bytearray()
        self._mark_ns: int | None = None
        self._bang_ns: int | None = None
        self._after_cr = False
        self._cr_ns = 0
        self._skipping = False

    def feed(self, data: bytes, received_ns: int) -> list[PtuEvent]:
        """Return the events that `data` completes.

        Args:
            data: what one read returned, cut anywhere.
            received_ns: the stamp of that read.
        """
        events: list[PtuEvent] = []
        for byte in data:
            if self._bang_ns is not None:
                bang_ns, self._bang_ns = self._bang_ns, None
                if byte in _LIMIT_AXES:
                    events.append(LimitFlag(_LIMIT_AXES[byte], received_ns))
                    continue
                if byte == _CABLE:
                    events.append(CableFlag(received_ns))
                    continue
                self._keep(_BANG_MARK, bang_ns, events)
            if byte == _BANG_MARK:
                self._bang_ns = received_ns
            else:
                self._keep(byte, received_ns, events)
        return events

    def _keep(self, byte: int, received_ns: int, events: list[PtuEvent]) -> None:
        """Add a byte that belongs to no flag to the line, or end the line by it."""
        if self._after_cr and byte != _LF:
            self._end_line(self._cr_ns, events)
        if not self._skipping:
            if len(self._line) >= self._limit and byte != _LF:
                raw = bytes(self._line)
                events.append(FrameError(FrameReason.OVERSIZE, raw, received_ns))
                self._line.clear()
                self._skipping = True
            elif len(self._line) < self._limit:
                self._line.append(byte)
                if self._mark_ns is None and byte in (_STAR_MARK, _BANG_MARK):
                    self._mark_ns = received_ns
        self._after_cr = byte == _CR
        self._cr_ns = received_ns
        if byte == _LF:
            self._end_line(received_ns, events)

    def _end_line(self, last_byte_ns: int, events: list[PtuEvent]) -> None:
        raw, mark_ns = bytes(self._line), self._mark_ns
        self._line.clear()
        self._mark_ns = None
        self._after_cr = False
        if self._skipping:
            self._skipping = False
        elif raw.strip():
            events.append(self._classify(raw, mark_ns, last_byte_ns))

    def _classify(self, raw: bytes, mark_ns: int | None, last_byte_ns: int) -> PtuEvent:
        """Return the event that one complete line is."""
        line = raw.strip(b" \t\r\n")
        if not (line.isascii() and line.replace(b"\t", b" ").decode("ascii").isprintable()):
            return FrameError(FrameReason.NOT_ASCII, raw, last_byte_ns)
        text = line.decode("ascii")
        marks = [at for at, letter in enumerate(text) if letter in "*!"]
        prefix = " ".join(text[: marks[0]].split()) if marks else text
        if _BANNER_WORDS.search(prefix):
            return Banner(text, last_byte_ns)
        is_echo = all(_COMMAND.fullmatch(word) for word in prefix.split())
        if mark_ns is None or not marks:
            if is_echo:
                return Echo(prefix, last_byte_ns)
            return FrameError(FrameReason.NO_STATUS, raw, last_byte_ns)
        reason = self._objection(prefix, is_echo, len(marks))
        if reason is not None:
            return FrameError(reason, raw, last_byte_ns)
        at = marks[0]
        return Reply(text[at] == "*", text[at + 1 :].strip(), prefix, raw, mark_ns, last_byte_ns)

    def _objection(self, prefix: str, is_echo: bool, marks: int) -> FrameReason | None:
        """Return why a line with a status mark is no reply to what was sent."""
        if not is_echo:
            return FrameReason.FOREIGN_PREFIX
        if marks > 1:
            return FrameReason.TWO_REPLIES
        # Several commands in one write come back as one run of words, or in parts of it.
        if self._expected and f" {prefix.upper()} " not in f" {self._expected} " and prefix:
            return FrameReason.OTHER_ECHO
        return None
