"""The log delays nobody: a pipe that nobody reads blocks the writer's own thread only."""

import os
import re
import select
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from gyrorig_daemon.session import line_writer
from gyrorig_daemon.session.line_writer import LineWriter, escape_controls


@contextmanager
def stderr_pipe() -> Iterator[int]:
    """Replace standard error by a pipe and yield its other end."""
    read_end, write_end = os.pipe()
    stream, before = os.fdopen(write_end, "w"), sys.stderr
    sys.stderr = stream
    try:
        yield read_end
    finally:
        sys.stderr = before
        os.close(read_end)
        stream.close()


def read_until(descriptor: int, text: str) -> str:
    data = b""
    while text.encode() not in data:
        assert select.select([descriptor], [], [], 60.0)[0]
        data += os.read(descriptor, 65_536)
    return data.decode()


def test_lines_in_order() -> None:
    with stderr_pipe() as pipe:
        with LineWriter() as writer:
            for number in range(5):
                writer.write_line(f"line\n {number}")
        assert read_until(pipe, "4\n") == "".join(f"line {number}\n" for number in range(5))


def test_a_full_pipe_drops_and_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_writer, "CLOSE_TIMEOUT_S", 0.05)
    drops: list[None] = []
    writer = LineWriter(lambda: drops.append(None))
    text = ""
    with stderr_pipe() as pipe:
        begun_s = time.monotonic()
        for _ in range(5_000):
            writer.write_line("x" * 200)  # the pipe holds 64 kB
        assert time.monotonic() - begun_s < 5.0
        assert writer.dropped == len(drops) > 3_000
        writer.close()  # does not wait for ever
        while select.select([pipe], [], [], 1.0)[0]:
            text += os.read(pipe, 65_536).decode()
    reported_lost = re.findall(r"^(\d+) lines are missing here", text, re.MULTILINE)
    assert sum(map(int, reported_lost)) == writer.dropped


def test_no_standard_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", None)
    with LineWriter() as writer:
        writer.write_line("nobody reads this")
    assert writer.dropped == 0


def test_control_characters_are_visible() -> None:
    with stderr_pipe() as pipe:
        with LineWriter() as writer:
            writer.write_line("a\x1b[2J\x9b\u2028b\r\nc")
        assert read_until(pipe, "\n") == "a\\x1b[2J\\x9b b c\n"
    assert escape_controls("é ∆") == "é ∆"
