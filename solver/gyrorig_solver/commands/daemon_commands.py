"""Commands of `gyrorigd` under `gyrorig`: the daemon's own program replaces this process.

The solver never imports the daemon; they share recordings and command lines.
"""

import os
import sys
from typing import NoReturn

import click

from gyrorig_protocol.child_process import module_command

_PASS_ALL_ARGUMENTS = {
    "ignore_unknown_options": True,
    "allow_extra_args": True,
    "help_option_names": [],
}


def daemon_command(*arguments: str) -> list[str]:
    """Return the command line that runs `gyrorigd` with this interpreter."""
    return module_command("gyrorig_daemon", *arguments)


def daemon_command_of(name: str) -> click.Command:
    """Return a command that runs `gyrorigd NAME` in place of this process.

    Signals then reach the daemon directly.
    """

    @click.command(name, context_settings=_PASS_ALL_ARGUMENTS, help=f"Run `gyrorigd {name}`.")
    @click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
    def run_daemon_command(arguments: tuple[str, ...]) -> NoReturn:
        if sys.stderr.isatty():
            click.echo(f"gyrorig: running `gyrorigd {name}`", err=True)
        sys.stdout.flush()
        sys.stderr.flush()
        command = daemon_command(name, *arguments)
        os.execv(command[0], command)  # noqa: S606 - our own interpreter, no shell

    return run_daemon_command


record_command = daemon_command_of("record")
emulate_command = daemon_command_of("emulate")
run_command = daemon_command_of("run")
doctor_command = daemon_command_of("doctor")
