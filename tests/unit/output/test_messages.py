"""Options, commands, files and keys named in messages exist; every error has a remedy."""

import re
from collections.abc import Iterator
from functools import cache
from typing import Any

import click
import msgspec
import pytest
from tests.unit.output.spoken import ROOT, UserText, errors, findings, texts

from gyrorig_daemon.commands.command_group import cli as gyrorigd
from gyrorig_daemon.config.rig_document import RigConfig
from gyrorig_solver.cli import cli as gyrorig

# Options of other programs, in commands that messages recommend.
OTHERS = {"--host", "--no-dashboard", "--nthreads", "--can", "--now"}
# Words after a program's name that are not commands.
PROSE = {"metadata", "lacks", "unknown", "that", "made"}
# Reasons why a schema or a message is invalid: `recording/topic_collector.py` adds the remedy.
REASONS = ("recording/encoding/cdr_codec.py", "recording/encoding/cdr_layout.py",
           "recording/encoding/ros2msg.py", "recording/messages.py",
           "recording/topic_collector.py")  # fmt: skip
# `explain_wrong_schema` returns problem and remedy together.
SAID_BEFORE = ("{*wrong_schema}",)

_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]+")
_COMMAND = re.compile(r"\b(gyrorigd?) ([a-z]+(?:-[a-z]+)*)(?: ([a-z]+(?:-[a-z]+)*))?([^`;,.:()|]*)")
_FILE = re.compile(r"\b(?:config|systemd|docs)/[\w./-]*\w")
_TARGET = re.compile(r"\bmake ([a-z]+-[a-z-]+)")
_KEYS = re.compile(
    r"(?<![\w/])(ptu|boards|service|site|emulator|buses)(?:: |\.)(?!md)([a-z_]+(?:: [a-z_]+)*)"
)
NO_KEYS = {("boards", "can"), ("site", "no")}  # a colon of prose


def _walk(command: click.Command, name: str) -> Iterator[tuple[str, click.Command]]:
    yield name, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for inner in command.list_commands(context):
            subcommand = command.get_command(context, inner)
            assert subcommand is not None
            yield from _walk(subcommand, f"{name} {inner}")


COMMANDS = dict([*_walk(gyrorig, "gyrorig"), *_walk(gyrorigd, "gyrorigd")])


def _options(command: click.Command) -> set[str]:
    words = (
        word
        for parameter in command.params
        for word in (*parameter.opts, *parameter.secondary_opts)
    )
    return {"--help", *words}


# `gyrorig record` and `serve_emulated_rig` hand their words on to gyrorigd, which reads them.
OPTIONS = {name: _options(command) for name, command in COMMANDS.items()}
for _word in ("record", "emulate"):
    OPTIONS[f"gyrorig {_word}"] |= OPTIONS[f"gyrorigd {_word}"]
ALL = set().union(*OPTIONS.values())


@cache
def _texts() -> tuple[UserText, ...]:
    """Return the texts, which take seconds: no worker needs them to collect the tests."""
    return tuple(texts())


def test_texts_are_found() -> None:
    assert len(_texts()) > 1500
    assert len(list(errors())) > 450
    assert len(list(findings())) > 60


def test_options_in_messages_exist() -> None:
    wrong = {
        (text.place, option)
        for text in _texts()
        for option in _OPTION.findall(text.text)
        if option not in ALL | OTHERS
    }
    assert not wrong


def test_commands_in_messages_exist_with_their_options() -> None:
    wrong = set()
    for text in _texts():
        for program, command, below, rest in _COMMAND.findall(text.text):
            name = f"{program} {command}"
            if command in PROSE:
                continue
            if f"{name} {below}" in COMMANDS:
                name = f"{name} {below}"
            if name not in COMMANDS:
                wrong.add((text.place, name))
                continue
            wrong |= {
                (text.place, f"{name} {option}")
                for option in _OPTION.findall(rest)
                if option not in OPTIONS[name]
            }
    assert not wrong


def test_files_and_targets_in_messages_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    wrong = {
        (text.place, name) for text in _texts() for name in _FILE.findall(text.text)
        if not (ROOT / name).exists()
    }  # fmt: skip
    wrong |= {
        (text.place, target) for text in _texts() for target in _TARGET.findall(text.text)
        if not re.search(rf"^{target}:", makefile, re.MULTILINE)
    }  # fmt: skip
    assert not wrong


def _fields(kind: msgspec.inspect.Type) -> Iterator[msgspec.inspect.Field]:
    match kind:
        case msgspec.inspect.StructType():
            yield from kind.fields
        case msgspec.inspect.UnionType():
            for member in kind.types:
                yield from _fields(member)
        case msgspec.inspect.ListType() | msgspec.inspect.VarTupleType():
            yield from _fields(kind.item_type)


def test_rig_keys_in_messages_exist() -> None:
    wrong = set()
    for text in _texts():
        for first, rest in _KEYS.findall(re.sub(r"{[^}]*}", "", text.text)):
            kind: Any = msgspec.inspect.type_info(RigConfig)
            for key in [first, *rest.split(": ")]:
                inside = {field.encode_name: field.type for field in _fields(kind)}
                if not inside or (first, key) in NO_KEYS:
                    break
                if key not in inside:
                    wrong.add((text.place, f"{first}: {rest}"))
                    break
                kind = inside[key]
    assert not wrong


def _without_remedy(texts: Iterator[UserText]) -> set[tuple[str, str]]:
    return {(text.place, text.text) for text in texts if not text.remedy}


def test_every_error_has_a_remedy() -> None:
    lacking = {
        (place, text) for place, text in _without_remedy(errors())
        if not any(name in place for name in REASONS) and text not in SAID_BEFORE
    }  # fmt: skip
    assert not lacking


def test_every_finding_has_a_remedy() -> None:
    assert not _without_remedy(
        finding for finding in findings() if finding.kind in ("fault", "warning")
    )


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_has_help_and_a_default(name: str) -> None:
    for parameter in COMMANDS[name].params:
        if not isinstance(parameter, click.Option):
            continue
        assert parameter.help, parameter.opts
        if (
            parameter.is_flag
            or parameter.required
            or parameter.show_default
            or parameter.opts == ["--version"]
        ):
            continue
        says = "default" in parameter.help or parameter.multiple
        assert says or parameter.help.startswith(
            ("Only ", "Of ", "With ", "In place of ", "Instead of ", "For ")
        ), parameter.opts
