"""Output of the commands: results, JSON, progress and errors.

What to use when: `Terminal.print_result` for text, `print_json` for the object of `--json`,
`print_progress` for a short step, `show_progress` around a step that can take seconds,
`format_table` for columns, `colour_verdict` for a verdict. Progress goes to standard error.
"""

import json
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import click

NOT_IDENTIFIABLE = 4  # exit status: done, but something is not identifiable from this data
PARTIAL = 5  # exit status: some inputs failed
PROGRESS_AFTER_S = 2.0
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


def finite_json(value: Any) -> Any:
    """Return `value` with null for numbers that JSON cannot express."""
    if isinstance(value, Mapping):
        return {key: finite_json(element) for key, element in value.items()}
    if isinstance(value, list | tuple):
        return [finite_json(element) for element in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass(slots=True)
class Terminal:
    """Output of one command."""

    json: bool = False
    traceback: bool = False
    quiet: bool = False
    verbose: bool = False

    @property
    def shows_progress(self) -> bool:
        """Progress is for a person at a terminal, or on request."""
        return not self.quiet and (self.verbose or sys.stderr.isatty())

    def print_result(self, text: str, verdict: str = "") -> None:
        """Write text to standard output, unless `--json` was given.

        Args:
            text: lines; control characters are escaped.
            verdict: colours the first line on a terminal.
        """
        if self.json:
            return
        first_line, separator, rest = printable(text).partition("\n")
        click.echo(colour_verdict(first_line, verdict) + separator + rest)

    def print_json(self, result: Mapping[str, Any]) -> None:
        """Write the JSON object of `--json`; without that option nothing."""
        if self.json:
            click.echo(json.dumps(finite_json(result), allow_nan=False))

    def print_progress(self, text: str) -> None:
        """Write one line of progress to standard error."""
        if self.shows_progress:
            click.echo(printable(text), err=True)

    @contextmanager
    def show_progress(self, text: str) -> Iterator[None]:
        """Show `text` while a step runs, with the elapsed time after two seconds."""
        if not self.shows_progress:
            yield
            return
        finished = threading.Event()
        thread = threading.Thread(target=_show_elapsed, args=(printable(text), finished))
        thread.start()
        try:
            yield
        finally:
            finished.set()
            thread.join()

    def print_error(self, text: str) -> None:
        """Write the error of one of several inputs as one line to standard error."""
        click.echo(f"gyrorig: {printable(' '.join(text.split()))}", err=True)


def _show_elapsed(text: str, finished: threading.Event) -> None:
    """Write a step's elapsed time once per second until it has finished."""
    start_s = time.monotonic()
    click.echo(text, err=True)
    is_terminal = sys.stderr.isatty()
    wait_s = PROGRESS_AFTER_S
    while not finished.wait(wait_s):
        wait_s = 1.0
        if is_terminal:
            click.echo(f"\r  {time.monotonic() - start_s:.0f} s", err=True, nl=False)
    elapsed_s = time.monotonic() - start_s
    if elapsed_s >= PROGRESS_AFTER_S:
        click.echo(f"{chr(13) if is_terminal else ''}  {elapsed_s:.0f} s", err=True)


def colour_verdict(text: str, verdict: str) -> str:
    """Return `text` in the colour of a verdict, on a terminal without NO_COLOR."""
    colour = _VERDICT_COLOURS.get(verdict)
    if colour is None or not sys.stdout.isatty() or os.environ.get("NO_COLOR"):
        return text
    return click.style(text, fg=colour, bold=True)


def format_table(rows: Sequence[Sequence[str]], right: Collection[int] = ()) -> list[str]:
    """Return rows as lines with aligned columns.

    Args:
        rows: texts of equal number per row.
        right: numbers of the columns to align at the right.
    """
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(
            text.rjust(width) if column in right else text.ljust(width)
            for column, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


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
