"""The entrance of `gyrorigd`: every error becomes one line and an exit code.

0 done; 1 failed, or stopped by a signal (the unit is halted and the recording closed
then); 2 wrong usage or configuration; 75 a port is busy. Nothing large is imported before
signals are taken care of: an impatient Ctrl-C ends the process without a traceback.
"""

import os
import signal
import sys
import traceback
from collections.abc import Sequence

TRACEBACK = "GYRORIG_TRACEBACK"  # set to anything: show where a fault comes from


def main() -> None:
    """Run `gyrorigd` and leave with its exit code."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # until a command takes it
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Carry out a command line and return its exit code."""
    try:
        if arguments[:1] == ["halt"]:  # at once, and when little else works: not all commands
            from gyrorig_daemon.halt_command import halt_command  # noqa: PLC0415

            name, rest = "gyrorigd halt", list(arguments[1:])
            returned = halt_command.main(rest, prog_name=name, standalone_mode=False)
        elif arguments[:1] == ["doctor"]:  # also where NumPy does not start, to say why
            from gyrorig_daemon.doctor.command import doctor_command  # noqa: PLC0415

            name, rest = "gyrorigd doctor", list(arguments[1:])
            returned = doctor_command.main(rest, prog_name=name, standalone_mode=False)
        else:
            from gyrorig_daemon.commands import cli  # noqa: PLC0415 - see above

            returned = cli.main(list(arguments), prog_name="gyrorigd", standalone_mode=False)
        if sys.stdout is not None:  # closed by whoever started us
            sys.stdout.flush()
    except BrokenPipeError:
        # Whoever read our words went away; what is left of them goes nowhere, silently.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as fault:  # noqa: BLE001, RUF100 - the edge: every error becomes one line
        if os.environ.get(TRACEBACK):
            traceback.print_exc()
        return _report(fault, "--json" in arguments)
    return returned if isinstance(returned, int) else 0


def _report(fault: Exception, as_json: bool) -> int:
    """Say in one line what `fault` is, and return the exit code for it."""
    import json  # noqa: PLC0415

    import click  # noqa: PLC0415

    from gyrorig_protocol.errors import GyrorigError  # noqa: PLC0415

    if isinstance(fault, click.exceptions.NoArgsIsHelpError):
        click.echo(fault.format_message(), err=True)
        return 2
    code = 1
    if isinstance(fault, GyrorigError):
        text, code = str(fault), fault.exit_code
    elif isinstance(fault, click.ClickException):
        context = getattr(fault, "ctx", None)
        where = "gyrorigd" if context is None else context.command_path
        text, code = f"{fault.format_message().rstrip('.')} (see {where} --help)", 2
    elif isinstance(fault, OSError):
        text = f"{fault.filename or 'this computer'}: {fault.strerror or fault}"
    else:
        text = (
            f"a fault of the program, {type(fault).__name__}: {fault}; "
            f"with {TRACEBACK}=1 it shows where"
        )
    text = " ".join(text.split())
    if as_json:
        click.echo(json.dumps({"error": text, "exit_code": code}))
    over_progress = "\r\x1b[K" if sys.stderr.isatty() else ""
    click.echo(f"{over_progress}gyrorigd: {text}", err=True)
    return code
