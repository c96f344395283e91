"""The log delays nobody: a pipe that nobody reads blocks the writer's own thread only."""

import os
import sys
import time
from collections.abc import Iterator

import pytest

from gyrorig_daemon.session import line_writer
from gyrorig_daemon.session.line_writer import LineWriter, escape_controls


@pytest.fixture
def pipe(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Replace standard error by a pipe and return its other end."""
    read_end, write_end = os.pipe()
    stream = os.fdopen(write_end, "w")
    monkeypatch.setattr(sys, "stderr", stream)
    yield read_end
    os.close(read_end)
    stream.close()


def read_until(descriptor: int, text: str) -> str:
    data = b""
    while text.encode() not in data:
        data += os.read(descriptor, 65_536)
    return data.decode()


def test_lines_in_order(pipe: int) -> None:
    with LineWriter() as writer:
        for number in range(5):
            writer.write_line(f"line\n {number}")
    assert read_until(pipe, "4\n") == "".join(f"line {number}\n" for number in range(5))


def test_a_full_pipe_drops_and_counts(pipe: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_writer, "CLOSE_TIMEOUT_S", 0.05)
    told: list[None] = []
    writer = LineWriter(lambda: told.append(None))
    begun_s = time.monotonic()
    for _ in range(5_000):
        writer.write_line("x" * 200)  # the pipe holds 64 kB
    assert time.monotonic() - begun_s < 5.0
    assert writer.dropped == len(told) > 3_000
    writer.close()  # does not wait for ever
    read_until(pipe, f"{writer.dropped} lines are missing here")


def test_no_standard_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", None)
    with LineWriter() as writer:
        writer.write_line("nobody reads this")
    assert writer.dropped == 0


def test_control_characters_are_visible(pipe: int) -> None:
    with LineWriter() as writer:
        writer.write_line("a\x1b[2J\x9b\u2028b\r\nc")
    assert read_until(pipe, "\n") == "a\\x1b[2J\\x9b b c\n"
    assert escape_controls("é ∆") == "é ∆"
