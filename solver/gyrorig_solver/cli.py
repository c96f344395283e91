"""The command `gyrorig`: what a desk does with recordings.

What is here: the group of commands, loaded one by one when asked for, and the one place
where an error becomes a line and an exit code. The commands are in
`gyrorig_solver.commands`, one module each.
"""

import errno
import gc
import importlib
import json
import os
import sys
import traceback
from collections.abc import Sequence
from typing import NoReturn

import click

from gyrorig_protocol.errors import GyrorigError, UsageError
from gyrorig_solver.commands.terminal import Terminal, printable, version_text

# command: (module of gyrorig_solver.commands, its one-line help). The help stands here so
# that `gyrorig --help` need not import scipy.
_COMMANDS = {
    "demo": ("demo", "The whole way on an emulated rig, from no hardware to a report."),
    "record": ("daemon", "Record one session (gyrorigd record)."),
    "emulate": ("daemon", "Open an emulated rig on ptys (gyrorigd emulate)."),
    "import": ("importing", "Turn measurements made elsewhere into a recording."),
    "check": ("check", "Is this recording sound, and what can it calibrate?"),
    "solve": ("solve", "Turn recordings into a calibration and a report."),
    "explain": ("explain", "What the model of the rig gets wrong, and why."),
    "apply": ("apply", "The true rates beside the readings of a recording or a table."),
    "export": ("export", "A calibration as C, ROS, Kalibr, PX4, ArduPilot or JSON."),
    "report": ("report", "A calibration's page, made again."),
    "batch": ("batch", "Every new recording of a spool, into a fleet's store."),
    "store": ("store", "What a fleet's store holds, and whether it is whole."),
    "fleet": ("fleet", "What the boards of a store are like, and what drifts."),
    "plan": ("plan", "The motion program that tells most in a given time."),
}
# a package that is not there, and the extra that brings it
_EXTRAS = {
    **dict.fromkeys(("scipy", "jinja2"), "solver"),
    **dict.fromkeys(("duckdb", "distributed", "s3fs", "cryptography"), "fleet"),
}
_INTERRUPTED = 130  # 128 + SIGINT, as shells have it


def _with_examples(command: click.Command) -> click.Command:
    """Keep the lines of examples: click's own mark cannot stand in a raw docstring."""
    if command.help:
        command.help = command.help.replace("\\b\n", "\b\n")
    return command


class _LazyGroup(click.Group):
    """A group whose commands are imported when one of them is run."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        module = importlib.import_module(f"gyrorig_solver.commands.{_COMMANDS[cmd_name][0]}")
        command = getattr(module, f"{cmd_name}_command")
        if not isinstance(command, click.Command):
            raise TypeError(f"{cmd_name} is no command")
        return _with_examples(command)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in _COMMANDS.items()])


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--traceback", is_flag=True, help="Show where in the program an error came from.")
@click.version_option(version_text(), "--version", message="gyrorig %(version)s")
@click.pass_obj
def cli(terminal: Terminal, traceback: bool) -> None:
    r"""Tell what a gyroscope really does, and how far to believe it.

    \b
    Example, without any hardware:
      gyrorig demo --out demo
    """
    terminal.traceback = traceback


_with_examples(cli)


def run(arguments: Sequence[str]) -> int:
    """Carry out one command line and return its exit code; never raises.

    The codes are those of the result contract: 0 done, 1 failed, 2 wrong usage, 3 input
    refused, 4 done but something is not identifiable, 5 done in part, 75 busy.
    """
    terminal = Terminal()
    try:
        returned = cli.main(
            args=list(arguments), prog_name="gyrorig", standalone_mode=False, obj=terminal
        )
        if sys.stdout is not None:  # closed by whoever started us
            sys.stdout.flush()
    except BrokenPipeError:
        # Whoever read our words went away; what is left of them goes nowhere, silently.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (KeyboardInterrupt, click.Abort):
        return _fail(terminal, "stopped by the keyboard", _INTERRUPTED)
    except Exception as fault:  # noqa: BLE001, RUF100 - the edge: every error becomes one line
        if terminal.traceback:
            traceback.print_exc()
        return _report(terminal, fault, arguments)
    return returned if isinstance(returned, int) else 0


def main() -> NoReturn:
    """Run the command line of this process and leave with its exit code."""
    # Before numpy is there: many small matrices are four times slower on several threads.
    for library in ("OPENBLAS", "OMP", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    # Loading makes many objects and no garbage: look for it less often.
    gc.set_threshold(50_000, 20, 20)
    code = run(sys.argv[1:])
    gc.freeze()  # nor while the process ends, which would take a tenth of a second
    sys.exit(code)


def _report(terminal: Terminal, fault: Exception, arguments: Sequence[str]) -> int:
    """Say in one line what `fault` is, and return the exit code for it."""
    if isinstance(fault, ModuleNotFoundError):
        extra = _EXTRAS.get((fault.name or "").split(".")[0])
        if extra is not None:
            fault = UsageError(
                f"this command needs {fault.name}, which is not installed",
                f"pip install 'gyrorig[{extra}]'",
            )
    if isinstance(fault, GyrorigError):
        return _fail(terminal, str(fault), fault.exit_code)
    if isinstance(fault, click.exceptions.NoArgsIsHelpError) and not terminal.json:
        click.echo(fault.format_message(), err=True)  # a group by itself: its help, in lines
        return 2
    if isinstance(fault, click.ClickException):
        context = getattr(fault, "ctx", None)
        where = context.command_path if context is not None else "gyrorig"
        return _fail(terminal, f"{fault.format_message().rstrip('.')} (see {where} --help)", 2)
    if isinstance(fault, OSError):
        return _fail(terminal, _of_the_system(fault), 1)
    if isinstance(fault, MemoryError):
        return _fail(terminal, "out of memory: solve fewer or shorter recordings at once", 1)
    again = " ".join(["gyrorig --traceback", *(a for a in arguments if a != "--traceback")])
    return _fail(
        terminal, f"a fault of the program, {type(fault).__name__}: {fault}; `{again}` shows it", 1
    )


def _of_the_system(fault: OSError) -> str:
    """Return what the computer refused, and what to do about it."""
    remedies = {
        errno.ENOENT: "name one that exists",
        errno.EACCES: "mend its rights, or name another",
        errno.EPERM: "mend its rights, or name another",
        errno.EISDIR: "it is a folder: name a file",
        errno.ENOTDIR: "it is a file: name a folder",
        errno.ENOSPC: "make room on its disk",
        errno.EROFS: "name one on a disk that can be written",
        errno.EMFILE: "allow more open files (ulimit -n)",
    }
    what = f"{fault.filename or 'something of this computer'} cannot be used"
    remedy = remedies.get(fault.errno or 0, "look at the disk and at the rights")
    return f"{what}, {fault.strerror or fault}: {remedy}"


def _fail(terminal: Terminal, text: str, code: int) -> int:
    line = printable(" ".join(text.split()))
    sys.stderr.write(f"gyrorig: {line}\n")
    if terminal.json:
        sys.stdout.write(json.dumps({"error": line, "exit_code": code}) + "\n")
    return code
