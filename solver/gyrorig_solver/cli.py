"""Entry point of `gyrorig`: the group of commands, and errors as one line and an exit status.

The commands are in `gyrorig_solver.commands`, one module each; each is imported when it runs.
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

from gyrorig_protocol.child_process import discard_output, open_closed_streams, protect_children
from gyrorig_protocol.errors import GyrorigError, UsageError, sentence
from gyrorig_protocol.suggestions import did_you_mean
from gyrorig_solver.commands.terminal import Terminal, printable, version_text

# command: (module of gyrorig_solver.commands, its short help). The help is here so that
# `gyrorig --help` need not import scipy.
_COMMANDS = {
    "demo": ("demo_command", "Calibrate an emulated rig and compare with the truth."),
    "record": ("daemon_commands", "Record one session (gyrorigd record)."),
    "run": ("daemon_commands", "Run the daemon in the foreground (gyrorigd run)."),
    "doctor": ("daemon_commands", "Check a rig (gyrorigd doctor)."),
    "emulate": ("daemon_commands", "Open an emulated rig (gyrorigd emulate)."),
    "import": ("import_command", "Convert other measurements to a recording."),
    "check": ("check_command", "Check recordings: losses, clocks, observability."),
    "solve": ("solve_command", "Calibrate boards from recordings."),
    "temperature": ("temperature_command", "Fit bias and scale against the temperature."),
    "compare": ("compare_command", "Compare a calibration with true values."),
    "twin": ("twin_command", "Write the emulated rig that behaves like a recorded one."),
    "explain": ("explain_command", "Find errors in the rig model and their causes."),
    "twin-check": ("twin_check_command", "Compare recordings with a twin."),
    "apply": ("apply_command", "Apply a calibration to a recording or a table."),
    "export": ("export_command", "Export as C, ROS, Kalibr, PX4, ArduPilot or JSON."),
    "report": ("report_command", "Write the HTML report of a calibration again."),
    "batch": ("batch_command", "Solve every new recording of a spool into a store."),
    "store": ("store_command", "List, compare and verify a store."),
    "fleet": ("fleet_command", "Find drift and outliers in a store."),
    "plan": ("plan_command", "Predict and optimise a motion program."),
}
# commands of gyrorigd that are not listed here but are passed on
_DAEMON_COMMANDS = (
    "status",
    "enqueue",
    "halt",
    "stop-motion",
    "clear",
    "reload",
    "recover",
    "causes",
)
# a missing package, and the extra that installs it
_EXTRAS = {
    **dict.fromkeys(("scipy", "jinja2"), "solver"),
    **dict.fromkeys(("duckdb", "distributed", "s3fs", "cryptography"), "fleet"),
}
_INTERRUPTED = 130  # 128 + SIGINT, as shells have it


def _keep_example_lines(command: click.Command) -> click.Command:
    """Keep the lines of examples: click's own mark cannot stand in a raw docstring."""
    if command.help:
        command.help = command.help.replace("\\b\n", "\b\n")
    if isinstance(command, click.Group):
        for subcommand in command.commands.values():
            _keep_example_lines(subcommand)
    return command


class _LazyGroup(click.Group):
    """A group whose commands are imported when one of them runs."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in _DAEMON_COMMANDS:
            module_name, attribute = "daemon_commands", "daemon_command_of"
        elif cmd_name in _COMMANDS:
            module_name, attribute = _COMMANDS[cmd_name][0], f"{cmd_name.replace('-', '_')}_command"
        else:
            return None
        module = importlib.import_module(f"gyrorig_solver.commands.{module_name}")
        command = getattr(module, attribute)
        if attribute == "daemon_command_of":
            command = command(cmd_name)
        if not isinstance(command, click.Command):
            raise TypeError(f"{cmd_name} is not a command")
        return _keep_example_lines(command)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if self.get_command(ctx, name) is None and not name.startswith("-"):
            suggestion = did_you_mean(name, [*_COMMANDS, *_DAEMON_COMMANDS])
            raise UsageError(
                f"{name!r} is not a command", suggestion or "`gyrorig --help` lists the commands"
            )
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in _COMMANDS.items()])


@click.group(
    cls=_LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="`gyrorig COMMAND --help` explains a command and has examples. Shell completion: "
    'eval "$(_GYRORIG_COMPLETE=bash_source gyrorig)".',
)
@click.option("-q", "--quiet", is_flag=True, help="Show no progress and no notes.")
@click.option("-v", "--verbose", is_flag=True, help="Show progress without a terminal, too.")
@click.option("--traceback", is_flag=True, help="Show where in the program an error comes from.")
@click.version_option(version_text(), "--version", message="gyrorig %(version)s")
@click.pass_obj
def cli(terminal: Terminal, quiet: bool, verbose: bool, traceback: bool) -> None:
    r"""Calibrate gyroscopes from pan-tilt recordings, with uncertainties.

    \b
    Example, without any hardware:
      gyrorig demo --out demo
    """
    terminal.traceback = traceback
    terminal.quiet, terminal.verbose = quiet, verbose
    click.get_current_context().with_resource(terminal.show_elapsed_time())


_keep_example_lines(cli)


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit status; never raises.

    docs/troubleshooting.md lists the statuses: 0 done, 1 failed, 2 wrong usage, 3 input refused,
    4 done but something is not identifiable, 5 done in part, 75 busy; 130 is Ctrl-C.
    """
    terminal = Terminal()
    try:
        returned = cli.main(
            args=list(arguments), prog_name="gyrorig", standalone_mode=False, obj=terminal
        )
        if sys.stdout is not None:  # closed by whoever started us
            sys.stdout.flush()
    except BrokenPipeError:
        # The reader of our output has gone: discard the rest.
        discard_output()
        return 1
    except (KeyboardInterrupt, click.Abort):
        return _print_failure(terminal, "stopped by Ctrl-C", _INTERRUPTED)
    except Exception as fault:  # noqa: BLE001, RUF100 - the edge: every error becomes one line
        if terminal.traceback:
            sys.stderr.write(printable(traceback.format_exc()))
        return _report_error(terminal, fault, arguments)
    return returned if isinstance(returned, int) else 0


def main() -> NoReturn:
    """Run the command line of this process and exit with its status."""
    protect_children()
    open_closed_streams()
    # Before numpy is imported: many small matrices are four times slower on several threads.
    for library in ("OPENBLAS", "OMP", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    # Loading creates many objects and no garbage: collect less often.
    gc.set_threshold(50_000, 20, 20)
    code = run(sys.argv[1:])
    gc.freeze()  # a collection at exit would take a tenth of a second
    sys.exit(code)


def _report_error(terminal: Terminal, fault: Exception, arguments: Sequence[str]) -> int:
    """Print an error as one line and return its exit status."""
    if isinstance(fault, ModuleNotFoundError):
        extra = _EXTRAS.get((fault.name or "").split(".")[0])
        if extra is not None:
            fault = UsageError(
                f"this command needs the Python package {fault.name}, which is not installed",
                f"run `pip install 'gyrorig[{extra}]'`",
            )
    if isinstance(fault, GyrorigError):
        return _print_failure(terminal, str(fault), fault.exit_code)
    if isinstance(fault, click.exceptions.NoArgsIsHelpError) and not terminal.json:
        click.echo(fault.format_message(), err=True)  # a group by itself: its help, in lines
        return 2
    if isinstance(fault, click.ClickException):
        context = getattr(fault, "ctx", None)
        command_path = context.command_path if context is not None else "gyrorig"
        return _print_failure(
            terminal, f"{sentence(fault.format_message())} See `{command_path} --help`.", 2
        )
    if isinstance(fault, OSError):
        return _print_failure(terminal, _system_error_text(fault), 1)
    if isinstance(fault, MemoryError):
        return _print_failure(
            terminal, "Out of memory. Solve fewer or shorter recordings at once.", 1
        )
    rerun = " ".join(["gyrorig --traceback", *(a for a in arguments if a != "--traceback")])
    return _print_failure(
        terminal,
        f"a fault in the program stopped this command: {type(fault).__name__}: {fault}. Run "
        f"`{rerun}` to see where.",
        1,
    )


def _system_error_text(fault: OSError) -> str:
    """Return an operating-system error and its remedy as one line."""
    remedies = {
        errno.ENOENT: "Give a name that exists.",
        errno.EACCES: "Fix its permissions (chmod or chown), or choose another file.",
        errno.EPERM: "Fix its permissions (chmod or chown), or choose another file.",
        errno.EISDIR: "It is a folder. Give a file.",
        errno.ENOTDIR: "It is a file. Give a folder.",
        errno.ENOSPC: "Free some space on its disk.",
        errno.EROFS: "Give a name on a disk that can be written.",
        errno.EMFILE: "Allow more open files (ulimit -n).",
    }
    name = fault.filename or "a resource of this computer"
    remedy = remedies.get(fault.errno or 0, "Check the disk and the permissions.")
    return f"{name} cannot be used ({fault.strerror or fault}). {remedy}"


def _print_failure(terminal: Terminal, text: str, code: int) -> int:
    line = printable(" ".join(text.split()))
    sys.stderr.write(f"gyrorig: {line}\n")
    if terminal.json:
        try:
            sys.stdout.write(json.dumps({"error": line, "exit_code": code}) + "\n")
            sys.stdout.flush()
        except OSError:  # for example a full disk, which is the failure itself
            discard_output()
    return code
