"""Every command to the emulated unit, in every mode of talking: each answer must be read.

The emulator's texts were written from the manuals and from what clients of real units
expect, not from this parser.
"""

import itertools
from typing import Literal

import pytest

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import PtuSettings, RigSettings
from gyrorig_daemon.emulator.ptu import EmulatedPtu
from gyrorig_protocol.ptu import (
    PROBE,
    AnswerKind,
    Axis,
    Dialect,
    LimitFlag,
    PtuCommand,
    PtuEvent,
    PtuReplyParser,
    Quantity,
    Refusal,
    RefusalKind,
    Reply,
    ValueFault,
    assign_quantity,
    dialect_features,
    dialect_from_probe,
    dialect_from_version,
    ptu_commands,
    query_quantity,
    read_value,
)

MODE_CHANGES = ("", "ED", "EE", "FT", "FV")
E_SERIES_ONLY = ("B", "BT", "CNT", "CNF", "VM", "VS")


def every_command() -> list[PtuCommand]:
    actual = [value for value in vars(ptu_commands).values() if isinstance(value, PtuCommand)]
    actual = [command for command in actual if command.text not in MODE_CHANGES]
    for axis in Axis:
        actual += [query_quantity(axis, quantity) for quantity in Quantity]
        actual += [ptu_commands.query_step_mode(axis), ptu_commands.query_hold_power(axis)]
        actual += [ptu_commands.query_move_power(axis), ptu_commands.halt_axis(axis)]
        actual += [
            assign_quantity(axis, Quantity.POSITION, 100),
            assign_quantity(axis, Quantity.BASE_SPEED, 57),
        ]
        actual += [PtuCommand(f"{axis.value}HL", AnswerKind.DONE)]  # low holding current
        actual += [PtuCommand(f"{axis.value}MR", AnswerKind.DONE)]  # regular moving current
        actual += [PtuCommand(f"W{axis.value}H", AnswerKind.DONE, 90.0)]  # half steps
        actual += [ptu_commands.reset_axis(axis)]
    return actual


class Unit:
    """An emulated unit on a line, and the parser that listens."""

    def __init__(self, settings: PtuSettings) -> None:
        unit = EmulatedRig(RigSettings(seed=1, ptu=settings, boards=()), 0).ptu
        assert isinstance(unit, EmulatedPtu)
        self._unit = unit
        self._parser = PtuReplyParser()
        self._now_ns = 1_000_000

    def ask(self, command: PtuCommand) -> Reply:
        self._parser.expect(command.text)
        self._unit.receive(command.encode(), self._now_ns)
        events: list[PtuEvent] = []
        while (due_ns := self._unit.next_output_ns()) is not None:
            self._now_ns = max(self._now_ns, due_ns)
            for _, data in self._unit.take_output(due_ns):
                events += self._parser.feed(data, self._now_ns)
        self._now_ns += 1_000_000_000
        (reply,) = [event for event in events if not isinstance(event, LimitFlag)]
        assert isinstance(reply, Reply)
        return reply


@pytest.mark.parametrize(
    ("dialect", "echo", "verbose"),
    list(itertools.product(["d46", "e46"], [False, True], [False, True])),
)
@pytest.mark.parametrize("unit_text", ["sec^2", "sec/sec"])
def test_every_answer_of_the_emulator_is_read(
    dialect: Literal["d46", "e46"],
    echo: bool,
    verbose: bool,
    unit_text: Literal["sec^2", "sec/sec"],
) -> None:
    unit = Unit(
        PtuSettings(dialect=dialect, echo=echo, verbose=verbose, acceleration_text=unit_text)
    )
    for command in every_command():
        reply = unit.ask(command)
        assert reply.echo == (command.text if echo else "")
        reading = read_value(command, reply)
        assert not isinstance(reading, ValueFault), (command.text, reply.raw)
        if isinstance(reading, Refusal):
            assert dialect == "d46"
            assert command.text in E_SERIES_ONLY
            assert reading.kind is RefusalKind.ILLEGAL_COMMAND
    beyond = assign_quantity(Axis.PAN, Quantity.POSITION, 5000)
    refusal = read_value(beyond, unit.ask(beyond))
    assert isinstance(refusal, Refusal)
    assert (refusal.kind, refusal.bound) == (RefusalKind.POSITION, 3090)


@pytest.mark.parametrize("dialect", ["d46", "e46"])
def test_the_dialect_of_the_emulator_is_identified(dialect: Literal["d46", "e46"]) -> None:
    unit = Unit(PtuSettings(dialect=dialect))
    assert dialect_from_probe(unit.ask(PROBE)) is Dialect(dialect)
    assert dialect_from_version(unit.ask(ptu_commands.QUERY_VERSION).text) is Dialect(dialect)
    motion = unit.ask(ptu_commands.QUERY_MOTION_AND_COUNTER)
    assert motion.ok is dialect_features(Dialect(dialect)).motion_with_counter
