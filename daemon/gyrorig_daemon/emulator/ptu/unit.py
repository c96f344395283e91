"""The emulated controller's state: axes, limits, modes. What the words mean is `language`.

Positions on the wire are in the step mode of now; the physics keeps the steps of the mode
at power-up. `ratio` is wire steps per physical step. Times are seconds since the origin
and grow from call to call.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

from gyrorig_daemon.emulator.line import Outbox
from gyrorig_daemon.emulator.physics.axis import StepperAxis
from gyrorig_daemon.emulator.physics.clock import DeviceClock
from gyrorig_daemon.emulator.physics.motion_law import MotionLaw
from gyrorig_daemon.emulator.settings import STEPS_PER_FULL_STEP, PtuSettings, StepMode

Letter = Literal["P", "T"]
LETTERS: tuple[Letter, Letter] = ("P", "T")


@dataclass(slots=True, eq=False)
class AxisState:
    """One axis as the controller knows it, in wire steps."""

    letter: Letter
    axis: StepperAxis
    minimum: int  # factory limits, in steps of the mode at power-up
    maximum: int
    margin: int
    known: bool  # homed: limits are found
    speed: int
    lower: int
    upper: int
    base: int
    acceleration: int
    step_mode: StepMode
    ratio: float = 1.0
    user_minimum: int = 0
    user_maximum: int = 0
    hold_power: str = "REGULAR"
    move_power: str = "REGULAR"
    pending: int | None = None  # target that waits for A or I

    @property
    def name(self) -> str:
        """The axis as replies name it."""
        return "Pan" if self.letter == "P" else "Tilt"

    def law(self) -> MotionLaw:
        """Return the limits of a move in physical steps."""
        speed = max(self.speed, 1)
        return MotionLaw(self.base / self.ratio, speed / self.ratio, self.acceleration / self.ratio)

    def count(self, time_s: float) -> int:
        """Return whole wire steps passed."""
        if self.ratio == 1.0:
            return self.axis.count(time_s)
        steps, speed = self.axis.state(time_s)
        wire = steps * self.ratio
        near = round(wire)
        if abs(wire - near) < 1e-6:
            return near
        return math.floor(wire) if speed >= 0.0 else math.ceil(wire)

    def target(self) -> int:
        """Return where the axis will rest, in wire steps."""
        return round(self.axis.target() * self.ratio)

    def speed_now(self, time_s: float) -> int:
        """Return the signed speed of now in wire steps/s."""
        return round(self.axis.state(time_s)[1] * self.ratio)

    def factory_limits(self) -> tuple[int, int]:
        """Return PN and PX: zero until the axis is homed."""
        if not self.known:
            return 0, 0
        return int(self.minimum * self.ratio), int(self.maximum * self.ratio)


@dataclass(slots=True, eq=False)
class PtuUnit:
    """The whole controller."""

    settings: PtuSettings
    axes: dict[Letter, AxisState]
    clock: DeviceClock
    origin_ns: int
    outbox: Outbox
    echo: bool
    verbose: bool
    limits: Literal["E", "D", "U"] = "E"
    slaved: bool = False
    velocity: bool = False
    unit_id: int = 0
    selected: bool = True
    broadcast: bool = False
    new_baud: int | None = None
    eeprom_writes: int = 0
    resets_at_power_up: bool = True

    def to_ns(self, time_s: float) -> int:
        """Return host time of a time since the origin."""
        return self.origin_ns + round(time_s * 1e9)

    def pan_tilt(self) -> tuple[AxisState, AxisState]:
        """Return both axes."""
        return self.axes["P"], self.axes["T"]

    def rests_at_s(self) -> float:
        """Return when both axes stand still."""
        return max(state.axis.rests_at_s() for state in self.axes.values())

    def bounds(self, state: AxisState) -> tuple[int, int] | None:
        """Return the limits in force in wire steps, None when they are switched off."""
        if self.limits == "D":
            return None
        if self.limits == "U":
            return state.user_minimum, state.user_maximum
        return state.factory_limits()

    def go(self, state: AxisState, time_s: float, wire_steps: float) -> None:
        """Start towards a wire position; the end of travel stops the axis and flags it."""
        axis = state.axis
        target = wire_steps / state.ratio
        shift = axis.shift_steps(time_s)
        lowest = state.minimum - state.margin - shift
        highest = state.maximum + state.margin - shift
        stopped = min(max(target, lowest), highest)
        self.outbox.drop_flags(f"!{state.letter}")
        axis.law = state.law()
        axis.move(time_s, stopped)
        if stopped != target:
            self.outbox.flag(self.to_ns(axis.rests_at_s()), f"!{state.letter}")

    def begin(self, state: AxisState, time_s: float, wire_steps: int) -> None:
        """Start towards a position now, or when A or I comes in slaved mode."""
        if self.slaved:
            state.pending = wire_steps
        else:
            self.go(state, time_s, wire_steps)

    def release(self, time_s: float) -> None:
        """Start every waiting target, both axes together."""
        for state in self.axes.values():
            if state.pending is not None:
                self.go(state, time_s, state.pending)
                state.pending = None

    def halt(self, state: AxisState, time_s: float) -> None:
        """Decelerate and stop."""
        state.pending = None
        self.outbox.drop_flags(f"!{state.letter}")
        state.axis.halt(time_s)

    def drive(self, state: AxisState, time_s: float, speed: int) -> None:
        """Pure velocity: the sign chooses the limit to go to, 0 halts."""
        if speed == 0:
            self.halt(state, time_s)
            return
        state.speed = abs(speed)
        low, high = state.factory_limits()
        if self.limits == "U":
            low, high = state.user_minimum, state.user_maximum
        self.go(state, time_s, high if speed > 0 else low)

    def apply_law(self, state: AxisState, time_s: float) -> None:
        """Let changed speeds act at once on a move under way."""
        if state.axis.moving(time_s) and not self.slaved:
            state.axis.set_law(time_s, state.law())
        else:
            state.axis.law = state.law()

    def home(self, state: AxisState, time_s: float, speed: float | None = None) -> float:
        """Sweep from stop to stop, then stand at the middle and call it zero.

        Both stops send a flag. Returns the time of the end.
        """
        axis = state.axis
        law = replace(state.law(), speed_steps_s=speed or self.settings.homing_speed_steps_s)
        self.outbox.drop_flags(f"!{state.letter}")
        axis.halt(time_s)
        end_s = axis.rests_at_s()
        shift = axis.shift_steps(end_s)
        for stop in (state.minimum - state.margin, state.maximum + state.margin):
            axis.move(end_s, stop - shift, law)
            end_s = axis.rests_at_s()
            self.outbox.send(self.to_ns(end_s), f"!{state.letter}".encode())
        axis.move(end_s, -shift, law)
        end_s = axis.rests_at_s()
        axis.recount(end_s, 0.0)
        axis.law = state.law()
        state.known = True
        state.pending = None
        return end_s

    def change_step_mode(self, state: AxisState, mode: StepMode) -> None:
        """Count in another fraction of a full step; speeds stay what they are."""
        new = STEPS_PER_FULL_STEP[mode] / STEPS_PER_FULL_STEP[self.settings.step_mode]
        factor = new / state.ratio
        state.ratio, state.step_mode = new, mode
        for field_name in ("speed", "lower", "upper", "base", "acceleration"):
            setattr(state, field_name, round(getattr(state, field_name) * factor))


def make_axis_state(letter: Letter, settings: PtuSettings, axis: StepperAxis) -> AxisState:
    """Return an axis as the controller has it after power-up."""
    pan = letter == "P"
    low = settings.pan_min_steps if pan else settings.tilt_min_steps
    high = settings.pan_max_steps if pan else settings.tilt_max_steps
    return AxisState(
        letter=letter,
        axis=axis,
        minimum=low,
        maximum=high,
        margin=settings.hard_stop_margin_steps,
        known=settings.homed,
        speed=settings.speed_steps_s,
        lower=settings.lower_speed_steps_s,
        upper=settings.upper_speed_steps_s,
        base=settings.base_speed_steps_s,
        acceleration=settings.acceleration_steps_s2,
        step_mode=settings.step_mode,
        user_minimum=low,
        user_maximum=high,
    )
