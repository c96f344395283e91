"""State of the emulated controller: axes, limits, modes. `axis_commands` interprets the commands.

Reported positions are in the present step mode; the physics uses the step mode at power-up. `ratio`
is reported steps per physical step. Times are seconds since the origin, in ascending order.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

from gyrorig_daemon.emulator.emulated_line import TransmitQueue
from gyrorig_daemon.emulator.emulator_settings import STEPS_PER_FULL_STEP, PtuSettings, StepMode
from gyrorig_daemon.emulator.physics.device_clock import DeviceClock
from gyrorig_daemon.emulator.physics.motion_law import MotionLaw
from gyrorig_daemon.emulator.physics.stepper_axis import StepperAxis

Letter = Literal["P", "T"]
LETTERS: tuple[Letter, Letter] = ("P", "T")


@dataclass(slots=True, eq=False)
class AxisState:
    """One axis as the controller knows it, in reported steps."""

    letter: Letter
    axis: StepperAxis
    factory_minimum: int  # factory limits, in steps of the mode at power-up
    factory_maximum: int
    stop_margin: int
    is_homed: bool  # the limits are known
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
    pending_target: int | None = None  # target that waits for the command A or I

    @property
    def name(self) -> str:
        """Name of the axis in replies."""
        return "Pan" if self.letter == "P" else "Tilt"

    def law(self) -> MotionLaw:
        """Return the limits of a move in physical steps."""
        speed = max(self.speed, 1)
        return MotionLaw(self.base / self.ratio, speed / self.ratio, self.acceleration / self.ratio)

    def count(self, time_s: float) -> int:
        """Return the whole reported steps that have passed."""
        if self.ratio == 1.0:
            return self.axis.count(time_s)
        steps, speed = self.axis.state(time_s)
        wire_steps = steps * self.ratio
        nearest = round(wire_steps)
        if abs(wire_steps - nearest) < 1e-6:
            return nearest
        return math.floor(wire_steps) if speed >= 0.0 else math.ceil(wire_steps)

    def target(self) -> int:
        """Return where the axis will stop, in reported steps."""
        return round(self.axis.target() * self.ratio)

    def speed_now(self, time_s: float) -> int:
        """Return the present signed speed in reported steps/s."""
        return round(self.axis.state(time_s)[1] * self.ratio)

    def factory_limits(self) -> tuple[int, int]:
        """Return PN and PX: zero until the axis is homed."""
        if not self.is_homed:
            return 0, 0
        return int(self.factory_minimum * self.ratio), int(self.factory_maximum * self.ratio)


@dataclass(slots=True, eq=False)
class UnitController:
    """The whole controller."""

    settings: PtuSettings
    axes: dict[Letter, AxisState]
    clock: DeviceClock
    origin_ns: int
    transmit_queue: TransmitQueue
    echo: bool
    verbose: bool
    limits: Literal["E", "D", "U"] = "E"
    is_slaved: bool = False
    in_velocity_mode: bool = False
    unit_id: int = 0
    selected: bool = True
    broadcast: bool = False
    new_baud: int | None = None
    resets_at_power_up: bool = True

    def to_ns(self, time_s: float) -> int:
        """Return the host time of a time since the origin."""
        return self.origin_ns + round(time_s * 1e9)

    def pan_tilt(self) -> tuple[AxisState, AxisState]:
        """Return both axes."""
        return self.axes["P"], self.axes["T"]

    def rests_at_s(self) -> float:
        """Return when both axes have stopped."""
        return max(state.axis.rests_at_s() for state in self.axes.values())

    def bounds(self, state: AxisState) -> tuple[int, int] | None:
        """Return the limits in force in reported steps, None if they are disabled."""
        if self.limits == "D":
            return None
        if self.limits == "U":
            return state.user_minimum, state.user_maximum
        return state.factory_limits()

    def start_move(self, state: AxisState, time_s: float, wire_steps: float) -> None:
        """Start a move to a position; the end of travel stops the axis and sends a flag."""
        axis = state.axis
        target = wire_steps / state.ratio
        shift = axis.shift_steps(time_s)
        lowest = state.factory_minimum - state.stop_margin - shift
        highest = state.factory_maximum + state.stop_margin - shift
        reachable = min(max(target, lowest), highest)
        self.transmit_queue.drop_flags(f"!{state.letter}")
        axis.law = state.law()
        axis.move(time_s, reachable)
        if reachable != target:
            self.transmit_queue.plan_flag(self.to_ns(axis.rests_at_s()), f"!{state.letter}")

    def request_position(self, state: AxisState, time_s: float, wire_steps: int) -> None:
        """Start a move now, or in slaved mode with the command A or I."""
        if self.is_slaved:
            state.pending_target = wire_steps
        else:
            self.start_move(state, time_s, wire_steps)

    def start_pending(self, time_s: float) -> None:
        """Start all waiting moves, both axes together."""
        for state in self.axes.values():
            if state.pending_target is not None:
                self.start_move(state, time_s, state.pending_target)
                state.pending_target = None

    def halt(self, state: AxisState, time_s: float) -> None:
        """Decelerate and stop."""
        state.pending_target = None
        self.transmit_queue.drop_flags(f"!{state.letter}")
        state.axis.halt(time_s)

    def set_velocity(self, state: AxisState, time_s: float, speed: int) -> None:
        """Set the velocity: the sign selects the limit to move to, 0 halts."""
        if speed == 0:
            self.halt(state, time_s)
            return
        state.speed = abs(speed)
        low, high = state.factory_limits()
        if self.limits == "U":
            low, high = state.user_minimum, state.user_maximum
        self.start_move(state, time_s, high if speed > 0 else low)

    def apply_law(self, state: AxisState, time_s: float) -> None:
        """Apply changed speeds to a move in progress."""
        if state.axis.is_moving(time_s) and not self.is_slaved:
            state.axis.set_law(time_s, state.law())
        else:
            state.axis.law = state.law()

    def home(self, state: AxisState, time_s: float, speed: float | None = None) -> float:
        """Sweep from stop to stop, then stop at the middle and set the count to zero.

        Both stops send a flag. Returns the time of the end.
        """
        axis = state.axis
        law = replace(state.law(), speed_steps_s=speed or self.settings.homing_speed_steps_s)
        self.transmit_queue.drop_flags(f"!{state.letter}")
        axis.halt(time_s)
        end_s = axis.rests_at_s()
        shift = axis.shift_steps(end_s)
        for stop in (
            state.factory_minimum - state.stop_margin,
            state.factory_maximum + state.stop_margin,
        ):
            axis.move(end_s, stop - shift, law)
            end_s = axis.rests_at_s()
            self.transmit_queue.send(self.to_ns(end_s), f"!{state.letter}".encode())
        axis.move(end_s, -shift, law)
        end_s = axis.rests_at_s()
        axis.recount(end_s, 0.0)
        axis.law = state.law()
        state.is_homed = True
        state.pending_target = None
        return end_s

    def change_step_mode(self, state: AxisState, mode: StepMode) -> None:
        """Count in another fraction of a full step; the physical speeds do not change."""
        new = STEPS_PER_FULL_STEP[mode] / STEPS_PER_FULL_STEP[self.settings.step_mode]
        factor = new / state.ratio
        state.ratio, state.step_mode = new, mode
        for field_name in ("speed", "lower", "upper", "base", "acceleration"):
            setattr(state, field_name, round(getattr(state, field_name) * factor))


def make_axis_state(letter: Letter, settings: PtuSettings, axis: StepperAxis) -> AxisState:
    """Return the controller's state of an axis after power-up."""
    pan = letter == "P"
    low = settings.pan_min_steps if pan else settings.tilt_min_steps
    high = settings.pan_max_steps if pan else settings.tilt_max_steps
    return AxisState(
        letter=letter,
        axis=axis,
        factory_minimum=low,
        factory_maximum=high,
        stop_margin=settings.hard_stop_margin_steps,
        is_homed=settings.homed,
        speed=settings.speed_steps_s,
        lower=settings.lower_speed_steps_s,
        upper=settings.upper_speed_steps_s,
        base=settings.base_speed_steps_s,
        acceleration=settings.acceleration_steps_s2,
        step_mode=settings.step_mode,
        user_minimum=low,
        user_maximum=high,
    )
