"""The entry point of `gyrorigd`: an error becomes one line and an exit status.

Exit status: 0 done; 1 failed, or stopped by SIGTERM or SIGHUP; 2 wrong usage or
configuration; 75 a port is busy; 130 stopped by Ctrl-C. After a stop the unit is halted and
the recording is closed. Nothing large is imported before the signal handler is set, so that
an early Ctrl-C ends the process without a traceback.
"""

import os
import signal
import sys
import traceback
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gyrorig_protocol.child_process import discard_output, open_closed_streams, protect_children

if TYPE_CHECKING:
    from gyrorig_daemon.commands.terminal import Terminal

TRACEBACK_VARIABLE = "GYRORIG_TRACEBACK"  # set to anything: the same as --traceback
INTERRUPTED = 130  # 128 + SIGINT, as in shells
_GROUP_FLAGS = ("--traceback", "-q", "--quiet", "-v", "--verbose")


def main() -> None:
    """Run `gyrorigd` and exit with its status."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # until a command handles it
    protect_children()
    open_closed_streams()
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit status."""
    from gyrorig_daemon.commands.terminal import Terminal  # noqa: PLC0415

    terminal = Terminal()
    try:
        returned = _run_command(list(arguments), terminal)
        if sys.stdout is not None:  # None if the parent process closed it
            sys.stdout.flush()
    except BrokenPipeError:
        # The reader of standard output is gone: discard the rest, without an error.
        discard_output()
        return 1
    except Exception as error:  # noqa: BLE001, RUF100 - the edge: every error becomes one line
        if terminal.traceback or os.environ.get(TRACEBACK_VARIABLE):
            _print_traceback()
        return _report_error(error, "--json" in arguments)
    return returned if isinstance(returned, int) else 0


def _run_command(arguments: list[str], terminal: "Terminal") -> object:
    name, words = "gyrorigd", list(arguments)
    while words and words[0] in _GROUP_FLAGS:
        word = words.pop(0)
        terminal.traceback |= word == "--traceback"
        terminal.quiet |= word in ("-q", "--quiet")
    # Two commands must start quickly, and also where most of the program cannot be loaded.
    if words[:1] == ["halt"]:
        from gyrorig_daemon.commands.halt_command import halt_command as command  # noqa: PLC0415
    elif words[:1] == ["doctor"]:
        from gyrorig_daemon.doctor.doctor_command import (  # noqa: PLC0415
            doctor_command as command,
        )
    else:
        from gyrorig_daemon.commands.command_group import cli  # noqa: PLC0415

        return cli.main(arguments, prog_name=name, standalone_mode=False, obj=terminal)
    from gyrorig_daemon.commands.terminal import (  # noqa: PLC0415
        ProgressLine,
        is_interactive,
        keep_example_lines,
    )

    command = keep_example_lines(command)
    with ProgressLine(is_interactive() and not terminal.quiet):
        return command.main(words[1:], prog_name=f"{name} {words[0]}", standalone_mode=False)


def _print_traceback() -> None:
    """Print the traceback of the current error; its text can be that of a device or of a file."""
    from gyrorig_daemon.commands.terminal import print_line  # noqa: PLC0415

    for line in traceback.format_exc().split("\n")[:-1]:
        print_line(line, to_stderr=True)


def _report_error(error: Exception, as_json: bool) -> int:
    """Print an error as one line and return the exit status for it."""
    import json  # noqa: PLC0415

    import click  # noqa: PLC0415

    from gyrorig_daemon.commands.terminal import print_line  # noqa: PLC0415
    from gyrorig_protocol.errors import GyrorigError, sentence  # noqa: PLC0415

    if isinstance(error, click.exceptions.NoArgsIsHelpError):
        click.echo(error.format_message(), err=True)
        return 2
    status = 1
    if isinstance(error, GyrorigError):
        text, status = str(error), error.exit_code
    elif isinstance(error, click.Abort):
        text, status = "stopped by Ctrl-C", INTERRUPTED
    elif isinstance(error, click.ClickException):
        context = getattr(error, "ctx", None)
        command_path = "gyrorigd" if context is None else context.command_path
        text, status = f"{sentence(error.format_message())} See `{command_path} --help`.", 2
    elif isinstance(error, OSError):
        text = f"{error.filename or 'this computer'}: {error.strerror or error}"
    else:
        text = (
            f"internal error {type(error).__name__}: {error}. "
            "`gyrorigd --traceback ...` shows where. Report it."
        )
    text = " ".join(text.split())
    clear_progress = "\r\x1b[K" if sys.stderr.isatty() else ""
    print_line(f"gyrorigd: {text}", to_stderr=True, prefix=clear_progress)
    if as_json:
        try:
            click.echo(json.dumps({"error": text, "exit_code": status}))
        except OSError:  # for example a full disk, which is the failure itself
            discard_output()
    return status
