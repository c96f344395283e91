"""What every command of `gyrorigd` shares: verbosity, help texts, progress.

What to use when: `Terminal` is the click object that the options of the group are stored in;
`keep_example_lines` for a command whose help has an example; `ProgressLine` for work of more
than two seconds.
"""

import sys
import time
from dataclasses import dataclass

import click

CONTEXT = {"help_option_names": ["-h", "--help"]}
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
            click.echo(text, err=True)


class ProgressLine:
    """One line on standard error that shows the steps done and the elapsed time."""

    def __init__(self, unit: str) -> None:
        self._unit = unit
        self._start_s = self._drawn_s = time.monotonic()

    def __call__(self, step: int, total: int) -> None:
        """Draw the line again. Call it as often as convenient."""
        now_s = time.monotonic()
        is_end = step == total
        if now_s - self._drawn_s < REDRAW_S and not is_end:
            return
        self._drawn_s = now_s
        elapsed = time.strftime("%M:%S", time.gmtime(now_s - self._start_s))
        text = f"\r{self._unit} {min(step + 1, total)} of {total}, {elapsed} elapsed "
        click.echo(text, nl=is_end, err=True)


def is_interactive() -> bool:
    """Return whether progress can be shown."""
    return sys.stderr is not None and sys.stderr.isatty()


def keep_example_lines(command: click.Command) -> click.Command:
    r"""Turn the `\b` of raw docstrings into click's mark for a paragraph that is not wrapped."""
    if command.help:
        command.help = command.help.replace("\\b\n", "\b\n")
    return command
