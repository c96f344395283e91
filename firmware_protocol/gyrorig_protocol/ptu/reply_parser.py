r"""Parser of a pan-tilt unit's byte stream.

Theory of operation
-------------------
The replies of real units do not follow one grammar: echo on or off, verbose or terse, CR or
space delimiters, and limit flags before or in the middle of any reply (sources: command
reference manual v3.00D; clients of real units). Therefore the parser has two layers, which do
not depend on the commands:

1. Bytes to lines, three states (`_TEXT`, `_BANG`, `_SKIP`):

       state   byte                 action                                next
       TEXT    !                    hold it back                          BANG
       TEXT    LF                   end the line                          TEXT
       TEXT    any, after a CR      end the line before it, then as TEXT  TEXT
       TEXT    any                  keep; over the limit: InvalidLine      TEXT / SKIP
       BANG    P, T, D              flag event, at once                   back
       BANG    any                  put the ! into the line, then as TEXT back
       SKIP    LF, or any after CR  forget the line                       TEXT
       SKIP    any                  drop                                  SKIP

   A flag is reported at once, even inside a line that is too long, because it means that steps
   were lost. The `!` of an error is followed by a space, so that the two cannot be confused. CR LF
   ends a line. LF alone does too, and CR alone as soon as the next byte is not LF. An empty line,
   such as the leading LF after a CR delimiter, is ignored.

2. Lines to events (`_classify_line`): echo, status mark, text. The rules are in
   `_COMMAND_PATTERN` and `_BANNER_WORDS`.

Contract: received bytes never raise an error. Anything else than a reply gives another event. The
events do not depend on where the stream was cut. Memory stays below `max_line_bytes`.
"""

import re

from gyrorig_protocol.ptu.ptu_events import (
    Axis,
    Banner,
    CableFlag,
    Echo,
    InvalidLine,
    InvalidLineReason,
    LimitFlag,
    PtuEvent,
    Reply,
)

_LF, _CR, _BANG_MARK, _STAR_MARK = b"\n\r!*"
_LIMIT_AXES = {ord("P"): Axis.PAN, ord("T"): Axis.TILT}
_CABLE_FLAG = ord("D")
_LINE_END = b"\r\n"
_SPECIAL = (b"\n", b"\r", b"!")
_RUNS = re.compile(rb"[^\n\r!]+|\r\n|[\n\r!]")
_STATUS_MARK = re.compile(r"[*!]")

# One or more commands: letters, then numbers, `B1,2,3,4`, `@(9600,0,F)`, `_0`, `?`.
_COMMAND_PATTERN = re.compile(r"(?:[A-Z]{1,4}|@|_|\?)[-+0-9.,()TF]*", re.IGNORECASE)
_BANNER_WORDS = re.compile(
    r"pan-tilt|directed perception|flir|rights reserved|\(c\)|copyright", re.IGNORECASE
)


class PtuReplyParser:
    """Parse a unit's bytes into replies, limit flags and other events, in any portions."""

    def __init__(self, max_line_bytes: int = 256) -> None:
        self._max_line_bytes = max_line_bytes
        self._expected_echo: str | None = None
        self.reset()

    @property
    def buffered_bytes(self) -> int:
        """Number of bytes of an unfinished line, at most `max_line_bytes`."""
        return len(self._line)

    def expect(self, command: str | None) -> None:
        """Set the command whose reply is expected, so that other echoes are rejected.

        Args:
            command: its text as sent; None accepts the echo of any command. Without echo it has
                no effect.
        """
        self._expected_echo = None if command is None else " ".join(command.upper().split())

    def reset(self) -> None:
        """Drop an unfinished line, for example after the input buffer was flushed."""
        self._line = bytearray()
        self._mark_ns: int | None = None
        self._bang_ns: int | None = None
        self._after_cr = False
        self._cr_ns = 0
        self._skipping = False

    def feed(self, data: bytes, received_ns: int) -> list[PtuEvent]:
        """Return the events that `data` completes.

        Args:
            data: the bytes of one read call, cut anywhere.
            received_ns: the timestamp of that read call.
        """
        events: list[PtuEvent] = []
        for run in _RUNS.findall(data):
            if not self._append_run(run, received_ns):
                for byte in run:
                    self._feed_byte(byte, received_ns, events)
            elif run == _LINE_END:
                self._end_line(received_ns, events)
        return events

    def _append_run(self, run: bytes, received_ns: int) -> bool:
        """Append bytes of the state TEXT at once; return False if they need the other states.

        Nearly all bytes are such bytes, and one step per byte takes ten times as long.
        """
        is_text = not (self._bang_ns is not None or self._after_cr or self._skipping)
        if run in _SPECIAL or not is_text:
            return False
        if len(self._line) + len(run) > self._max_line_bytes:
            return False
        self._line += run
        if self._mark_ns is None and _STAR_MARK in run:
            self._mark_ns = received_ns
        return True

    def _feed_byte(self, byte: int, received_ns: int, events: list[PtuEvent]) -> None:
        if self._bang_ns is not None:
            bang_ns, self._bang_ns = self._bang_ns, None
            if byte in _LIMIT_AXES:
                events.append(LimitFlag(_LIMIT_AXES[byte], received_ns))
                return
            if byte == _CABLE_FLAG:
                events.append(CableFlag(received_ns))
                return
            self._append_byte(_BANG_MARK, bang_ns, events)
        if byte == _BANG_MARK:
            self._bang_ns = received_ns
        else:
            self._append_byte(byte, received_ns, events)

    def _append_byte(self, byte: int, received_ns: int, events: list[PtuEvent]) -> None:
        """Append a byte that is not part of a flag to the line, or end the line with it."""
        if self._after_cr and byte != _LF:
            self._end_line(self._cr_ns, events)
        if not self._skipping:
            if len(self._line) >= self._max_line_bytes and byte != _LF:
                raw = bytes(self._line)
                events.append(InvalidLine(InvalidLineReason.OVERSIZE, raw, received_ns))
                self._line.clear()
                self._skipping = True
            elif len(self._line) < self._max_line_bytes:
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
            events.append(self._classify_line(raw, mark_ns, last_byte_ns))

    def _classify_line(self, raw: bytes, mark_ns: int | None, last_byte_ns: int) -> PtuEvent:
        line = raw.strip(b" \t\r\n")
        text = line.decode("ascii", "replace")
        if not (line.isascii() and text.replace("\t", " ").isprintable()):
            return InvalidLine(InvalidLineReason.NOT_ASCII, raw, last_byte_ns)
        mark = _STATUS_MARK.search(text)
        prefix = text if mark is None else " ".join(text[: mark.start()].split())
        if _BANNER_WORDS.search(prefix):
            return Banner(text, last_byte_ns)
        is_echo = all(_COMMAND_PATTERN.fullmatch(word) for word in prefix.split())
        if mark_ns is None or mark is None:
            if is_echo:
                return Echo(prefix, last_byte_ns)
            return InvalidLine(InvalidLineReason.NO_STATUS, raw, last_byte_ns)
        value = text[mark.end() :]
        reason = self._reject_reason(prefix, is_echo, value)
        if reason is not None:
            return InvalidLine(reason, raw, last_byte_ns)
        return Reply(mark[0] == "*", value.strip(), prefix, raw, mark_ns, last_byte_ns)

    def _reject_reason(self, prefix: str, is_echo: bool, value: str) -> InvalidLineReason | None:
        """Return why a line with a status mark is not the expected reply, None if it is."""
        if not is_echo:
            return InvalidLineReason.FOREIGN_PREFIX
        if _STATUS_MARK.search(value):
            return InvalidLineReason.TWO_REPLIES
        # The echo of several commands in one write can come as one sequence of words or in parts.
        if (
            self._expected_echo
            and f" {prefix.upper()} " not in f" {self._expected_echo} "
            and prefix
        ):
            return InvalidLineReason.OTHER_ECHO
        return None
