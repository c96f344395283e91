"""The words of a unit that answers each command with one reply.

What to use when: `TextLanguage` in the module of a driver; `text_unit.TextUnit` drives the unit
with it, and `gyrorigd halt` and `gyrorigd doctor` use the same words. `with_commands` replaces
words by those of the rig file. The words are lines of text, or a `framing` translates them to the
frames of the unit.

In a command, `{axis}` is the name of the axis and `{value}` a number in units of `unit_deg`. A
pattern is a regular expression for a whole reply. The ends, the speeds and the acceleration can be
a number in deg, deg/s or deg/s^2 instead of a query.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace

from gyrorig_daemon.motion.framing import Framing, LineFraming
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.ptu import Axis
from gyrorig_protocol.suggestions import did_you_mean

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_FIRST_NUMBER = re.compile(NUMBER)
FIRST_NUMBER = rf"(?P<value>{NUMBER})"


@dataclass(frozen=True, slots=True)
class TextLanguage:
    """The commands and replies of a unit; see the module.

    Attributes:
        axes: the name of each axis of the unit in its commands.
        resolution_deg: size of a step of the driver, usually the smallest difference between two
            positions that the unit can report.
        unit_deg: size of the unit of `{value}` and of all numbers in replies, in deg: 1 for
            degrees, 0.001 for millidegrees. A unit that takes only whole numbers needs a
            `resolution_deg` that is a multiple of it.
        framing: makes the translation between words and bytes; None for lines of text.
        line_end: end of every line of text.
        min_interval_s: shortest time between two requests.
        identify: asks for the identity.
        identity: pattern of the identity, with the groups `model`, `serial` and `firmware`.
        ready: commands that prepare the unit, separated by `|`.
        home: searches the zero; "" if the unit needs none.
        target: starts a move to an angle.
        speed: sets the speed of moves.
        acceleration: sets the acceleration of moves.
        halt: stops all axes.
        accepted: pattern of the reply to a command that was accepted.
        position: asks for the position; with `{axis}` the axes are asked in turn.
        positions: pattern with the groups `pan` and `tilt`, or `value` with `{axis}` in `position`;
            an optional group `moving` is 0 at rest.
        lowest, highest: the ends of travel, a query or a number in deg.
        slowest, fastest: the speeds of moves, a query or a number in deg/s.
        number: pattern that is searched in the replies to the queries of `lowest`, `highest`,
            `slowest`, `fastest` and `rate_change`, with the group `value`; by default the first
            number. A reply that repeats the name of the axis needs another pattern.
        rate_change: the acceleration in force, a query or a number in deg/s^2. A number is valid
            until the driver sends `acceleration`; then the acceleration in the command is in force.
    """

    name: str
    axes: Mapping[Axis, str]
    identity: str
    target: str
    speed: str
    halt: str
    position: str
    positions: str
    accepted: str
    identify: str = "*IDN?"
    acceleration: str = ""
    ready: str = ""
    home: str = ""
    lowest: str = "-180"
    highest: str = "180"
    slowest: str = "0.001"
    fastest: str = "100"
    rate_change: str = "100"
    number: str = FIRST_NUMBER
    line_end: str = "\n"
    resolution_deg: float = 1e-4
    unit_deg: float = 1.0
    framing: Callable[[], Framing] | None = None
    min_interval_s: float = 0.02

    @property
    def halt_bytes(self) -> bytes:
        """Bytes that stop the unit; the first ones end a truncated command."""
        framing = self.make_framing()
        return framing.halt_prefix + framing.encode(self.halt)

    def make_framing(self) -> Framing:
        """Return the translation between words and bytes for one line."""
        return LineFraming(self.line_end) if self.framing is None else self.framing()

    def with_commands(self, commands: Mapping[str, str]) -> "TextLanguage":
        """Return the language with other words.

        Raises:
            UsageError: a name is not a word of the language, or a pattern is invalid.
        """
        names = [field.name for field in fields(self) if field.type is str]
        names.remove("name")
        for name, text in commands.items():
            if name not in names:
                raise UsageError(
                    f"{name!r} under ptu.commands in the rig file is not a command of the driver "
                    f"{self.name}",
                    did_you_mean(name, names) or f"use one of {', '.join(names)}",
                )
            if name in ("identity", "positions", "accepted", "number"):
                _check_pattern(name, text)
        return replace(self, **dict(commands))  # type: ignore[arg-type]

    def format(self, command: str, axis: Axis, value_deg: float = 0.0) -> str:
        """Return a command for an axis with a value in deg, deg/s or deg/s^2."""
        value = f"{value_deg / self.unit_deg:.9f}".rstrip("0").rstrip(".")
        return command.replace("{axis}", self.axes[axis]).replace("{value}", value)

    def is_accepted(self, reply: str) -> bool:
        """Return whether a reply says that a command was accepted."""
        return re.fullmatch(self.accepted, reply) is not None

    def read_identity(self, reply: str) -> dict[str, str] | None:
        """Return model, serial and firmware; None if another device has replied."""
        match = re.fullmatch(self.identity, reply)
        return None if match is None else {k: v or "" for k, v in match.groupdict().items()}

    def read_value_deg(self, reply: str) -> float | None:
        """Return the number in a reply, in deg, deg/s or deg/s^2; None without one."""
        match = re.search(self.number, reply)
        number = None if match is None else read_number(match["value"])
        return None if number is None else number * self.unit_deg

    def read_positions(self, reply: str, asked: Axis) -> tuple[dict[Axis, int], bool | None]:
        """Return positions in steps, and whether the unit is at rest as far as it says so.

        Args:
            reply: the reply to `position`.
            asked: the axis in the request.
        """
        match = re.fullmatch(self.positions, reply)
        if match is None:
            return {}, None
        groups = match.groupdict()
        texts = {axis: groups.get(axis.label) for axis in self.axes}
        if groups.get("value") is not None:
            texts = {asked: groups["value"]}
        steps = {}
        for axis, text in texts.items():
            number = None if text is None else read_number(text)
            if number is not None and abs(number * self.unit_deg) < self.resolution_deg * 2**31:
                steps[axis] = round(number * self.unit_deg / self.resolution_deg)
        moving = groups.get("moving")
        return steps, None if moving is None else moving == "0"


def read_number(text: str) -> float | None:
    """Return the first number in a text, None without one."""
    match = _FIRST_NUMBER.search(text)
    return None if match is None else float(match[0])


def _check_pattern(name: str, text: str) -> None:
    try:
        pattern = re.compile(text)
    except re.error as error:
        raise UsageError(
            f"the pattern {name!r} under ptu.commands in the rig file is not a regular expression "
            f"({error})",
            "correct the pattern",
        ) from error
    if name == "number" and "value" not in pattern.groupindex:
        raise UsageError(
            "the pattern 'number' under ptu.commands in the rig file has no group `value`",
            "write the number in the pattern as (?P<value>...)",
        )
