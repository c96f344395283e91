"""Descriptions of the commands of both programs, from their code, for the manual and the site.

What to use when: `PROGRAMS` for both programs, `describe_commands` for the commands of one.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import click

from gyrorig_daemon.commands.command_group import cli as gyrorigd
from gyrorig_solver.cli import cli as gyrorig

PROGRAMS: dict[str, click.Group] = {"gyrorig": gyrorig, "gyrorigd": gyrorigd}
EXIT_CODES = (
    (0, "done"),
    (1, "failed: a fault of the program or of the machine"),
    (2, "wrong usage or configuration"),
    (3, "input refused: damaged, empty, or not a recording"),
    (4, "done, but something is not identifiable from this data"),
    (5, "done in part: some inputs failed; the counts are printed"),
    (75, "busy: a port or a store is in use; try again"),
    (130, "stopped by Ctrl-C"),
)


@dataclass(frozen=True, slots=True)
class CommandDescription:
    """One command: its usage, purpose, examples, and options with their help."""

    name: str  # "gyrorig store verify"
    usage: str
    paragraphs: tuple[str, ...]
    examples: tuple[str, ...]
    options: tuple[tuple[str, str], ...]


def describe_commands(program: str) -> Iterator[CommandDescription]:
    """Yield the commands of a program, each group before its commands."""
    yield from _describe_tree(program, PROGRAMS[program], None)


def _describe_tree(
    name: str, command: click.Command, parent: click.Context | None
) -> Iterator[CommandDescription]:
    # The width does not depend on the terminal.
    context = click.Context(
        command, info_name=name.rsplit(maxsplit=1)[-1], parent=parent, terminal_width=200
    )
    if parent is not None:
        yield _describe_command(name, command, context)
    if isinstance(command, click.Group):
        for inner in command.list_commands(context):
            subcommand = command.get_command(context, inner)
            if subcommand is not None and not subcommand.hidden:
                yield from _describe_tree(f"{name} {inner}", subcommand, context)


def _describe_command(
    name: str, command: click.Command, context: click.Context
) -> CommandDescription:
    paragraphs, examples = _split_help(command.help or "")
    options = []
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None and record[1] and "--help" not in record[0]:
            options.append((record[0], " ".join(record[1].split())))
    usage = " ".join([name, *command.collect_usage_pieces(context)])
    return CommandDescription(name, usage, paragraphs, examples, tuple(options))


def _split_help(text: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Split a docstring into its paragraphs and the command lines of its examples."""
    paragraphs: list[str] = []
    examples: list[str] = []
    for block in text.replace("\b\n", "").replace("\\b\n", "").split("\n\n"):
        lines = [line.strip() for line in block.strip().splitlines()]
        if lines and lines[0].startswith("Example"):
            first = lines[0].partition(":")[2].strip()
            for line in [first, *lines[1:]]:
                if line.startswith(("gyrorig", "sudo")) or (line and not examples):
                    examples.append(line)
                elif line:  # a continued line
                    examples[-1] = f"{examples[-1].removesuffix(chr(92)).rstrip()} {line}"
        elif lines:
            paragraphs.append(" ".join(lines))
    return tuple(paragraphs), tuple(example for example in examples if example)
