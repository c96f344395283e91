"""What every command of `gyrorigd` shares: verbosity, help texts, progress.

What to use when: `Terminal` is the click object that the options of the group are stored in;
`print_line` for a line with a text of a device or of a file;
`keep_example_lines` for a command whose help has an example; `ProgressLine` for work of more
than two seconds.
"""

import sys
import threading
import time
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import click

from gyrorig_daemon.session.line_writer import LineWriter, escape_controls

CONTEXT = {"help_option_names": ["-h", "--help"]}
ELAPSED_AFTER_S = 2.0  # a shorter command shows no time
REDRAW_S = 0.2  # a terminal need not be redrawn more often


@dataclass(slots=True)
class Terminal:
    """How much a command prints on standard error."""

    traceback: bool = False
    quiet: bool = False  # no progress and no notes
    verbose: bool = False  # every event of a session

    def note(self, text: str) -> None:
        """Print one line on standard error, unless `--quiet` was given."""
        if not self.quiet:
            print_line(text, to_stderr=True)


class ProgressLine:
    """One line on standard error with the elapsed time of a command, and the steps done.

    A context manager. Text that the command prints replaces the line. A terminal that takes
    nothing delays nobody.
    """

    def __init__(self, is_shown: bool) -> None:
        self._is_shown = is_shown
        self.writer = LineWriter()
        self._text = ""
        self._start_s = self._drawn_s = time.monotonic()
        self._finished = threading.Event()
        self._thread = threading.Thread(target=self._redraw, daemon=True)

    def __enter__(self) -> Self:
        """Begin to show the elapsed time, after two seconds."""
        if self._is_shown:
            self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Erase the line."""
        if self._is_shown:
            self._finished.set()
            self._thread.join()
            self.writer.write("\r\x1b[K")
        self.writer.close()

    def __call__(self, step: int, total: int) -> None:
        """Draw the line with a step. Call it as often as convenient."""
        self._text = f"step {min(step + 1, total)} of {total}, "
        is_end = step == total
        if self._is_shown and (is_end or time.monotonic() - self._drawn_s >= REDRAW_S):
            self._draw("\n" if is_end else "\r")

    def _redraw(self) -> None:
        wait_s = ELAPSED_AFTER_S
        while not self._finished.wait(wait_s):
            wait_s = 1.0
            self._draw("\r")

    def _draw(self, end: str) -> None:
        self._drawn_s = time.monotonic()
        elapsed = time.strftime("%M:%S", time.gmtime(self._drawn_s - self._start_s))
        self.writer.write(f"\r{self._text}{elapsed} elapsed {end}")


def print_line(text: str, *, to_stderr: bool = False, prefix: str = "") -> None:
    """Print one line; control characters of the text are escaped, those of the prefix are not.

    A device or a file can send control sequences, which a terminal obeys.
    """
    click.echo(prefix + escape_controls(text), err=to_stderr)


def is_interactive() -> bool:
    """Return whether progress can be shown."""
    return sys.stderr is not None and sys.stderr.isatty()


def keep_example_lines(command: click.Command) -> click.Command:
    r"""Turn the `\b` of raw docstrings into click's mark for a paragraph that is not wrapped."""
    if command.help:
        command.help = command.help.replace("\\b\n", "\b\n")
    return command
