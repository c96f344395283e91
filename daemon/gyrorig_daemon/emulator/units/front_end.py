"""What plays a motion unit on its line: characters in, replies out, over the physics of the axes.

What to use when: `EmulatedTextUnit` for a unit that answers each line with one line; implement
`reply` and name the class in `FRONT_END`. For a unit of binary frames, implement `take_command` and
`answer` of `EmulatedAnsweringUnit`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gyrorig_daemon.emulator.emulated_line import ReceiveLine, TransmitQueue
from gyrorig_daemon.emulator.emulator_settings import PtuSettings
from gyrorig_daemon.emulator.physics.device_clock import DeviceClock
from gyrorig_daemon.emulator.physics.motion_law import MotionLaw
from gyrorig_daemon.emulator.physics.stage_motion import Stage
from gyrorig_daemon.emulator.physics.stepper_axis import StepperAxis

ARCSEC_PER_DEG = 3600.0
MAX_COMMAND_BYTES = 200


class EmulatedUnit(Protocol):
    """A unit on its line; see `emulated_rig.EmulatedDevice`."""

    def receive(self, data: bytes, at_ns: int) -> None:
        """Accept bytes that arrive from `at_ns` on, at the baud rate."""
        ...

    def next_output_ns(self) -> int | None:
        """Return when the next bytes have left the line, None if there are none."""
        ...

    def take_output(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return the bytes that have left the line up to `until_ns`, with their times."""
        ...


MakeUnit = Callable[[PtuSettings, Stage, DeviceClock, int, np.random.Generator], EmulatedUnit]


@dataclass(frozen=True, slots=True)
class FrontEnd:
    """One emulated unit, as its module names it in `FRONT_END`.

    Attributes:
        make: makes the unit on its stage at power-up.
        adjust: changes the settings of the axes (step size, range, speeds) to those of the unit.
    """

    make: MakeUnit
    adjust: Callable[[PtuSettings], PtuSettings] = lambda settings: settings


@dataclass(slots=True)
class EmulatedAxis:
    """One axis in deg, deg/s and deg/s^2, over the physics in steps."""

    axis: StepperAxis
    step_deg: float
    lowest_deg: float
    highest_deg: float
    speed_deg_s: float
    acceleration_deg_s2: float

    def position_deg(self, time_s: float) -> float:
        """Return the counted position."""
        return self.axis.count(time_s) * self.step_deg

    def is_moving(self, time_s: float) -> bool:
        """Return whether the axis moves."""
        return self.axis.is_moving(time_s)

    def move(self, time_s: float, target_deg: float) -> bool:
        """Start a move from standstill speed 0; False if the target is outside the range."""
        if not self.lowest_deg <= target_deg <= self.highest_deg:
            return False
        self.axis.move(time_s, round(target_deg / self.step_deg), self._law())
        return True

    def halt(self, time_s: float) -> None:
        """Decelerate and stop."""
        self.axis.law = self._law()
        self.axis.halt(time_s)

    def _law(self) -> MotionLaw:
        speed, acceleration = self.speed_deg_s, self.acceleration_deg_s2
        return MotionLaw(0.0, speed / self.step_deg, acceleration / self.step_deg)


class EmulatedAnsweringUnit:
    """A unit that answers each command with one reply.

    A subclass implements `take_command` and `answer`.

    Attributes:
        settings: settings of the axes and of the line.
        pan: the pan axis.
        tilt: the tilt axis.
    """

    def __init__(
        self,
        settings: PtuSettings,
        stage: Stage,
        clock: DeviceClock,
        origin_ns: int,
        rng: np.random.Generator,
    ) -> None:
        """Power the unit up at `origin_ns`."""
        del clock, rng  # of units with a counter, and of faults
        self.settings = settings
        self.pan = _axis(settings, stage.pan, settings.pan_min_steps, settings.pan_max_steps)
        self.tilt = _axis(settings, stage.tilt, settings.tilt_min_steps, settings.tilt_max_steps)
        self._origin_ns = self._busy_until_ns = origin_ns
        self._receive_line = ReceiveLine(settings.baud)
        self._transmit_queue = TransmitQueue(settings.baud)
        self._input = bytearray()

    def take_command(self, received: bytearray) -> bytes | None:
        """Remove the first complete command from `received` and return it, None without one.

        It is called after each byte. Bytes that belong to no command must be removed, too.
        """
        raise NotImplementedError

    def answer(self, command: bytes, time_s: float) -> bytes | None:
        """Execute a command at a time, in s since power-up; None for no reply."""
        raise NotImplementedError

    def receive(self, data: bytes, at_ns: int) -> None:
        """Accept bytes that arrive from `at_ns` on."""
        self._transmit_queue.advance(at_ns)
        arrivals = self._receive_line.arrivals(len(data), at_ns)
        for byte, arrived_ns in zip(data, arrivals, strict=True):
            self._input.append(byte)
            command = self.take_command(self._input)
            if command is not None:
                self._handle_command(command, arrived_ns)
            elif len(self._input) > MAX_COMMAND_BYTES:
                self._input.clear()

    def next_output_ns(self) -> int | None:
        """Return when the next bytes have left the line."""
        return self._transmit_queue.next_ns()

    def take_output(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return the bytes that have left the line up to a time."""
        return self._transmit_queue.take(until_ns)

    def _handle_command(self, command: bytes, arrived_ns: int) -> None:
        command_ns = round(self.settings.command_time_ms * 1e6)
        start_ns = max(arrived_ns, self._busy_until_ns)
        act_ns = start_ns + round(command_ns * self.settings.sample_fraction)
        data = self.answer(command, (act_ns - self._origin_ns) * 1e-9)
        self._busy_until_ns = start_ns + command_ns
        if data is not None and not self.settings.faults.silent:
            self._transmit_queue.send(self._busy_until_ns, data, split_first=True)


class EmulatedTextUnit(EmulatedAnsweringUnit):
    """A unit that answers each line with one line. A subclass implements `reply`."""

    line_end = b"\n"

    def reply(self, line: str, time_s: float) -> str | None:
        """Execute a line at a time, in s since power-up; None for no reply."""
        raise NotImplementedError

    def take_command(self, received: bytearray) -> bytes | None:
        """See `EmulatedAnsweringUnit`; empty lines are ignored."""
        if received[-1] not in b"\r\n":
            return None
        line = bytes(received).strip()
        received.clear()
        return line or None

    def answer(self, command: bytes, time_s: float) -> bytes | None:
        """See `EmulatedAnsweringUnit`."""
        text = self.reply(command.decode("ascii", "replace"), time_s)
        return None if text is None else text.encode("ascii") + self.line_end


def _axis(
    settings: PtuSettings, axis: StepperAxis, lowest_steps: int, highest_steps: int
) -> EmulatedAxis:
    step_deg = settings.resolution_arcsec / ARCSEC_PER_DEG
    return EmulatedAxis(
        axis,
        step_deg,
        lowest_steps * step_deg,
        highest_steps * step_deg,
        settings.speed_steps_s * step_deg,
        settings.acceleration_steps_s2 * step_deg,
    )
