"""Output of the commands: results, JSON, progress and errors.

What to use when: `Terminal.print_result` for text, `print_json` for the object of `--json`,
`print_progress` for the name of a step, `show_status` for a count that changes, `colour_verdict`
for a verdict. Progress goes to standard error. On a terminal every command shows its elapsed time
after two seconds.
"""

import json
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import click

from gyrorig_protocol.documents import finite_values
from gyrorig_protocol.errors import sentence
from gyrorig_protocol.suggestions import did_you_mean

NOT_IDENTIFIABLE = 4  # exit status: done, but something is not identifiable from this data
PARTIAL = 5  # exit status: some inputs failed
PROGRESS_AFTER_S = 2.0
_ERASE_LINE = "\x1b[K"  # to the end of the line
_VERDICT_COLOURS = {
    "good": "green",
    "limited": "yellow",
    "refused": "red",
    "adequate": "green",
    "explained": "yellow",
    "unexplained": "yellow",
}

Command = TypeVar("Command", bound=Callable[..., Any])


def version_text() -> str:
    """Return the version of the installed project."""
    return version("gyrorig")


def printable(text: str) -> str:
    """Return `text` without terminal control characters; lines stay lines.

    Names in recordings come from devices and are untrusted.
    """
    return "".join(c if c == "\n" or c.isprintable() else ascii(c)[1:-1] for c in text)


@dataclass(slots=True)
class Terminal:
    """Output of one command."""

    json: bool = False
    traceback: bool = False
    quiet: bool = False
    verbose: bool = False
    data_on_stdout: bool = False  # then the text of the result is on standard error
    _start_s: float = field(default_factory=time.monotonic)
    _lock: threading.RLock = field(default_factory=threading.RLock)
    _status: str = ""  # the text before the elapsed time
    _is_drawn: bool = False  # the line with the elapsed time is on the screen
    _is_paused: bool = False

    @property
    def shows_progress(self) -> bool:
        """Progress is for a person at a terminal, or on request."""
        return not self.quiet and (self.verbose or sys.stderr.isatty())

    @property
    def _elapsed_s(self) -> float:
        return time.monotonic() - self._start_s

    def print_result(self, text: str, verdict: str = "") -> None:
        """Write text to standard output, unless `--json` was given or data is there.

        Args:
            text: lines; control characters are escaped.
            verdict: colours the first line on a terminal.
        """
        if self.json:
            return
        first_line, separator, rest = printable(text).partition("\n")
        self.erase_elapsed_time()
        click.echo(colour_verdict(first_line, verdict) + separator + rest, err=self.data_on_stdout)

    def print_json(self, result: Mapping[str, Any]) -> None:
        """Write the JSON object of `--json`; without that option nothing."""
        if self.json:
            self.erase_elapsed_time()
            click.echo(json.dumps(finite_values(result), allow_nan=False))

    def print_progress(self, text: str) -> None:
        """Write one line of progress to standard error."""
        if self.shows_progress:
            self.erase_elapsed_time()
            click.echo(printable(text), err=True)

    def show_status(self, text: str) -> None:
        """Show `text` before the elapsed time, on a terminal; "" for the time alone."""
        self._status = printable(text)
        self._draw_elapsed_time()

    @contextmanager
    def show_elapsed_time(self) -> Iterator[None]:
        """Show the elapsed time of the command after two seconds: on a terminal while it runs."""
        finished = threading.Event()
        thread = threading.Thread(target=self._update_elapsed_time, args=(finished,), daemon=True)
        if self.shows_progress and sys.stderr.isatty():
            thread.start()
        try:
            yield
        finally:
            finished.set()
            if thread.ident is not None:
                thread.join()
            if self._elapsed_s >= PROGRESS_AFTER_S:
                self.print_progress(f"  {self._elapsed_s:.0f} s elapsed")

    @contextmanager
    def hide_elapsed_time(self) -> Iterator[None]:
        """Leave standard error to another program."""
        self._is_paused = True
        self.erase_elapsed_time()
        try:
            yield
        finally:
            self._is_paused = False

    def erase_elapsed_time(self) -> None:
        """Erase the line with the elapsed time, for other text in its place."""
        with self._lock:
            if self._is_drawn:
                click.echo(f"\r{_ERASE_LINE}", err=True, nl=False)
            self._is_drawn = False

    def _update_elapsed_time(self, finished: threading.Event) -> None:
        wait_s = PROGRESS_AFTER_S - self._elapsed_s
        while not finished.wait(max(wait_s, 0.0)):
            wait_s = 1.0
            self._draw_elapsed_time()

    def _draw_elapsed_time(self) -> None:
        with self._lock:
            if self._is_paused or not (self.shows_progress and sys.stderr.isatty()):
                return
            elapsed = f"{self._elapsed_s:.0f} s elapsed"
            text = f"{self._status}, {elapsed}" if self._status else f"  {elapsed}"
            columns = shutil.get_terminal_size().columns - 1
            click.echo(f"\r{text[:columns]}{_ERASE_LINE}", err=True, nl=False)
            self._is_drawn = True

    def print_error(self, text: str) -> None:
        """Write the error of one of several inputs as one line to standard error."""
        self.erase_elapsed_time()
        click.echo(f"gyrorig: {printable(' '.join(text.split()))}", err=True)


def colour_verdict(text: str, verdict: str) -> str:
    """Return `text` in the colour of a verdict, on a terminal without NO_COLOR."""
    colour = _VERDICT_COLOURS.get(verdict)
    if colour is None or not sys.stdout.isatty() or os.environ.get("NO_COLOR"):
        return text
    return click.style(text, fg=colour, bold=True)


class SuggestingChoice(click.Choice):  # type: ignore[type-arg] # a generic class from click 8.2
    """One of some words; a mistyped word gets a suggestion."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the word.

        Raises:
            BadParameter: it is not one of the words.
        """
        if value in self.choices:
            return value
        remedy = did_you_mean(value[:40], self.choices) or f"use {', '.join(self.choices)}"
        self.fail(f"{value!r:.40} is not a possible value. {sentence(remedy)}", param, ctx)


class _OutputOption(click.Option):
    """`-o, --output`; `--out` is accepted too and is not shown in the help."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Return the help without the accepted spelling."""
        record = super().get_help_record(ctx)
        return record and (record[0].replace(", --out ", " "), record[1])


def output_option(text: str, *, required: bool = False) -> Callable[[Command], Command]:
    """Give a command the option `-o, --output FILE`, as parameter `out`."""
    return click.option(
        "-o",
        "--output",
        "--out",
        "out",
        cls=_OutputOption,
        type=click.Path(path_type=Path, dir_okay=False),
        required=required,
        help=text,
    )


def folder_option(default: str, text: str) -> Callable[[Command], Command]:
    """Give a command the option `--out FOLDER`, as parameter `out`."""
    return click.option(
        "--out",
        type=click.Path(path_type=Path, file_okay=False),
        default=Path(default),
        show_default=True,
        help=text,
    )


def choice_option(
    option: str, choices: Sequence[str], default: str, text: str, parameter: str | None = None
) -> Callable[[Command], Command]:
    """Give a command an option with some words, as `parameter`, or named as the option."""
    return click.option(
        *(option, parameter or option.strip("-").replace("-", "_")),
        type=SuggestingChoice(choices),
        default=default,
        show_default=True,
        help=text,
    )


def board_option(command: Command) -> Command:
    """Give a command the option `--board`."""
    return click.option(
        "--board", help="Only this board.  [default: every board in the recordings]"
    )(command)


def _set_json(context: click.Context, _parameter: click.Parameter, value: bool) -> None:
    if value:
        context.find_object(Terminal).json = True  # type: ignore[union-attr] # set by run()


def json_option(command: Command) -> Command:
    """Give a command the option `--json`."""
    return click.option(
        "--json",
        is_flag=True,
        expose_value=False,
        is_eager=True,
        callback=_set_json,
        help="Print one machine-readable object instead of text.",
    )(command)


def contradiction_option(command: Command) -> Command:
    """Give a command the option `--allow-contradiction`."""
    return click.option(
        "--allow-contradiction",
        is_flag=True,
        help="Fit the recordings of a board together even if their gains contradict each other. "
        "By default such recordings are refused.",
    )(command)
