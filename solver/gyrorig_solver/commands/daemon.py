"""`gyrorig record` and `gyrorig emulate`: handed to the daemon's own program.

The desk never imports the rig: the two meet in recordings and on the command line.
"""

import os
import sys
from typing import NoReturn

import click

_PASS_ALL = {"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []}


def daemon_command(*arguments: str) -> list[str]:
    """Return the command line that runs `gyrorigd` with this interpreter."""
    return [sys.executable, "-m", "gyrorig_daemon", *arguments]


def _become(*arguments: str) -> NoReturn:
    """Replace this process by the daemon, so that signals reach it directly."""
    sys.stdout.flush()
    sys.stderr.flush()
    command = daemon_command(*arguments)
    os.execv(command[0], command)  # noqa: S606 - our own interpreter, no shell


@click.command("record", context_settings=_PASS_ALL)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def record_command(arguments: tuple[str, ...]) -> NoReturn:
    """Record one session: `gyrorigd record`."""
    _become("record", *arguments)


@click.command("emulate", context_settings=_PASS_ALL)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def emulate_command(arguments: tuple[str, ...]) -> NoReturn:
    """Open an emulated rig on ptys: `gyrorigd emulate`."""
    _become("emulate", *arguments)
