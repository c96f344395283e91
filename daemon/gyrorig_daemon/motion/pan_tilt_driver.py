"""The interface between the daemon and a motion unit of any maker.

What to use when: implement `PanTiltDriver` in a module of `drivers`, and name it there in `DRIVER`.
A unit that answers each command with one reply needs only a `TextLanguage`, see `text_unit`.
`drivers.find_driver` finds a driver by the name in the rig file.

The daemon counts each axis in steps. A driver chooses the size of a step, states it in `UnitFacts`
and converts all values of its unit to steps. A unit without a tilt axis answers for pan only.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import msgspec

from gyrorig_daemon.config import PTU_PORT, PtuPort
from gyrorig_daemon.links.pump import Pump
from gyrorig_daemon.motion.ptu_exchange import Exchange, PtuLineCounts
from gyrorig_daemon.motion.text_language import TextLanguage
from gyrorig_daemon.motion.unit_facts import Homing, UnitFacts
from gyrorig_protocol.errors import DeviceError, UsageError
from gyrorig_protocol.motion_orders import AxisOrder, OrderAxis
from gyrorig_protocol.program import PtuSettings
from gyrorig_protocol.ptu import Axis


@dataclass(frozen=True, slots=True)
class AxisTarget:
    """The target and the speed of one axis."""

    axis: Axis
    target_steps: int
    speed_steps_s: int


class Poll(msgspec.Struct, frozen=True, gc=False):
    """One request of the position.

    Attributes:
        request: text of the request, for people.
        exchange: the request and its reply, or an attempt to bring the line in step.
        steps: position of each axis that answered; empty without a usable reply.
        is_still: whether the unit reports that it is at rest; None if it does not report this.
        counter: the unit's own counter at that time, None if it has none.
        earliest_ns: the unit read its position after this.
        latest_ns: and before this.
    """

    request: str
    exchange: Exchange
    steps: Mapping[Axis, int]
    is_still: bool | None
    counter: int | None
    earliest_ns: int
    latest_ns: int


class PanTiltDriver(Protocol):
    """One unit on its port. Every method except `halt` is called with the unit at rest or polled.

    Attributes:
        name: name of the driver, as in the rig file.
        location: name of the port in errors.
        counts: faults of the line.
        axes: the axes that the unit has.
        halt_bytes: bytes that stop the unit in any state. They move no other device.
        is_port_gone: the port is disconnected.
        is_identified: the device on the port has identified itself as the expected unit.
        lost_synchrony: why the reported position is wrong, None while it is right.
    """

    @property
    def name(self) -> str: ...  # noqa: D102 - see Attributes

    @property
    def axes(self) -> tuple[Axis, ...]: ...  # noqa: D102

    @property
    def halt_bytes(self) -> bytes: ...  # noqa: D102

    @property
    def location(self) -> str: ...  # noqa: D102

    @property
    def counts(self) -> PtuLineCounts: ...  # noqa: D102

    @property
    def is_port_gone(self) -> bool: ...  # noqa: D102

    @property
    def is_identified(self) -> bool: ...  # noqa: D102

    @property
    def lost_synchrony(self) -> str | None: ...  # noqa: D102

    def identify(self) -> None:
        """Check that the expected unit is on the port, and halt it.

        Raises:
            DeviceError: it is silent, another device, or does not halt.
        """
        ...

    def set_up(self, settings: PtuSettings, homing: Homing) -> UnitFacts:
        """Home the unit if needed and allowed, apply settings, read its capabilities.

        Raises:
            DeviceError: it refuses a command.
            UsageError: it needs homing, which is not allowed, or does not support the settings.
        """
        ...

    def set_poll_rate(self, rate_hz: float) -> None:
        """Poll at most that often."""
        ...

    def start_move(self, targets: Sequence[AxisTarget]) -> None:
        """Start a move; several axes start together. Return without waiting for its end.

        Raises:
            DeviceError: it refuses, does not answer, or is not identified.
        """
        ...

    def send_orders(self, orders: Sequence[AxisOrder]) -> None:
        """Send the orders of one exchange, in steps. Return without waiting for the end of a move.

        Raises:
            DeviceError: it refuses, does not answer, or is not identified.
            UsageError: the unit has no command for an order.
        """
        ...

    def poll(self) -> Poll:
        """Request the position of one or all axes.

        Raises:
            DeviceError: the port is gone.
        """
        ...

    def halt(self) -> None:
        """Halt all axes, whatever is in progress, and wait for the acknowledgement.

        Raises:
            DeviceError: the unit does not acknowledge.
        """
        ...

    def forget_losses(self) -> None:
        """Forget that the synchrony was lost; a later loss is reported again."""
        ...

    def begin_session(self) -> None:
        """Forget losses, because a session begins that detects losses itself."""
        ...


@dataclass(frozen=True, slots=True)
class DriverPort:
    """What a driver gets: its port, its section of the rig file, and who records."""

    pump: Pump
    location: str
    config: PtuPort
    on_exchange: Callable[[Exchange], None]
    port: str = PTU_PORT


@dataclass(frozen=True, slots=True)
class DriverEntry:
    """One driver, as its module names it in `DRIVER`.

    Attributes:
        title: the units that it drives, for people.
        make: makes the driver; it sends nothing.
        language: the words of a unit that answers each command with one reply; with them
            `gyrorigd halt` and `gyrorigd doctor` talk to the unit without the daemon.
        halt_bytes: for a driver without `language`, the bytes that stop its unit in any state;
            `gyrorigd halt` sends them.
    """

    title: str
    make: Callable[[DriverPort], PanTiltDriver]
    language: Callable[[PtuPort], TextLanguage] | None = None
    halt_bytes: bytes = b""


AXES_OF_ORDERS = {OrderAxis.PAN: Axis.PAN, OrderAxis.TILT: Axis.TILT}


def no_command_error(order: AxisOrder, name: str) -> UsageError:
    """Return the error for an order that a driver cannot send."""
    return UsageError(
        f"the driver {name} has no command for an order of the kind {order.kind.name.lower()}",
        "replay the recording on a unit with the same driver",
    )


def unidentified_error(location: str) -> DeviceError:
    """Return the error for a unit that must identify itself before anything moves."""
    return DeviceError(
        f"the pan-tilt unit on {location} was disconnected, so its position is not known",
        "check the cable of the unit. The daemon identifies the unit again before it moves",
    )


def no_answer_error(location: str, command: str) -> DeviceError:
    """Return the error for a unit that does not answer."""
    return DeviceError(
        f"the pan-tilt unit on {location} does not answer the command {command!r}",
        "check the power of the unit, its cable and its baud rate",
    )
