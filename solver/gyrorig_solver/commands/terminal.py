"""What every command shares: where its words go, and its version.

What to use when: `say` for a result a person reads, `emit` for the one object of
`--json`, `progress` for what is being done now. Progress goes to standard error, and
only on a terminal.
"""

import json
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, TypeVar

import click

NOT_IDENTIFIABLE = 4  # done, but something asked for cannot be told from this data
IN_PART = 5  # some inputs failed, some did not

Command = TypeVar("Command", bound=Callable[..., Any])


def version_text() -> str:
    """Return the version of the installed project."""
    return version("gyrorig")


def printable(text: str) -> str:
    """Return `text` without what would steer a terminal; lines stay lines.

    Names in recordings come from devices and strangers.
    """
    return "".join(c if c == "\n" or c.isprintable() else ascii(c)[1:-1] for c in text)


def finite(value: Any) -> Any:
    """Return `value` with null for numbers that JSON has no word for."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass(slots=True)
class Terminal:
    """The way from a command to the person, or program, that called it."""

    json: bool = False
    traceback: bool = False

    def say(self, text: str) -> None:
        """Write a result to standard output, unless it shall be JSON."""
        if not self.json:
            click.echo(printable(text))

    def emit(self, result: Mapping[str, Any]) -> None:
        """Write the one JSON object of `--json`; nothing without that option."""
        if self.json:
            click.echo(json.dumps(finite(result), allow_nan=False))

    def progress(self, text: str) -> None:
        """Say what is being done, on standard error, if that is a terminal."""
        if sys.stderr.isatty():
            click.echo(printable(text), err=True)

    def complain(self, text: str) -> None:
        """Say in one line, on standard error, what one of several inputs met."""
        click.echo(f"gyrorig: {printable(' '.join(text.split()))}", err=True)


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
