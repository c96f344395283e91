"""The group of all commands of `gyrorigd`."""

import click

from gyrorig_daemon.commands.causes_command import causes_command
from gyrorig_daemon.commands.emulate_command import emulate_command
from gyrorig_daemon.commands.halt_command import halt_command
from gyrorig_daemon.commands.record_command import record_command
from gyrorig_daemon.commands.recover_command import recover_command
from gyrorig_daemon.commands.terminal import CONTEXT, Terminal, keep_example_lines
from gyrorig_daemon.doctor.doctor_command import doctor_command
from gyrorig_daemon.service.service_commands import COMMANDS as SERVICE_COMMANDS
from gyrorig_protocol.errors import sentence
from gyrorig_protocol.recording.writer import software_version
from gyrorig_protocol.suggestions import did_you_mean

_EPILOG = (
    "`gyrorigd COMMAND --help` describes a command. Completion for bash, or likewise zsh or fish: "
    'eval "$(_GYRORIGD_COMPLETE=bash_source gyrorigd)"'
)
_DESK_COMMANDS = {  # of the program `gyrorig`
    *("apply", "batch", "check", "demo", "explain", "export"),
    *("fleet", "import", "plan", "report", "solve", "store"),
}


class _SuggestingGroup(click.Group):
    """A group that names the nearest commands when a name is mistyped."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if self.get_command(ctx, name) is None and not name.startswith("-"):
            if name in _DESK_COMMANDS:
                hint = f"use `gyrorig {name}`"
            else:
                hint = did_you_mean(name, self.commands) or "`gyrorigd --help` lists all commands"
            raise click.UsageError(f"No such command {name!r}. {sentence(hint)}", ctx)
        return super().resolve_command(ctx, args)


@click.group(cls=_SuggestingGroup, context_settings=CONTEXT, epilog=_EPILOG)
@click.option("--traceback", is_flag=True, help="Show where in the program an error came from.")
@click.option("-q", "--quiet", is_flag=True, help="Print no progress and no notes.")
@click.option("-v", "--verbose", is_flag=True, help="Print every event of a session.")
@click.version_option(software_version(), message="%(version)s")
@click.pass_context
def cli(context: click.Context, traceback: bool, quiet: bool, verbose: bool) -> None:
    r"""Run a calibration rig: record sessions, serve a queue, emulate a rig.

    \b
    Example:
      gyrorigd record --config config/rig.yaml \
        --program config/programs/survey-40.yaml
    """
    terminal = context.ensure_object(Terminal)
    terminal.traceback, terminal.quiet, terminal.verbose = traceback, quiet, verbose


keep_example_lines(cli)
for _command in (
    record_command,
    emulate_command,
    causes_command,
    recover_command,
    halt_command,
    doctor_command,
    *SERVICE_COMMANDS,
):
    cli.add_command(keep_example_lines(_command))
