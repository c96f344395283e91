"""Options of the command line for an emulated rig. The emulator itself is not imported here."""

from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.program import (
    Home,
    MotionProgram,
    Move,
    PtuSettings,
    Rest,
    unroll_manual_steps,
    unroll_steps,
)

_TABLE_UPDATE_S = 12.5  # a unit computes its tables again for each base speed and acceleration
_PREPARATION_S = 4.0  # of a replay, in addition: identification, capabilities, first positions
_PAUSE_S = 4.0  # of a person, between two steps
_ACCELERATION_DEG_S2 = 100.0  # factory setting


@dataclass(frozen=True, slots=True)
class EmulationOptions:
    """Options for an emulated rig, in addition to its configuration."""

    seed: int | None = None  # replaces the seed of the configuration
    session_seed: int | None = None  # of the noise of the session; None: it follows from `seed`
    draw: int = 0  # number of the draw from the posterior of a twin; 0: its best values
    is_replay: bool = False
    twin_recording: str | None = None  # whose single events happen, see `make_twin_rig`
    truth: Path | None = None
    rates: Path | None = None  # see `emulator.noise_free_rates`
    with_plain_rates: bool = True  # write also the rates without the hidden causes
    hide: tuple[str, ...] = ()  # see `causes.parse_injection`
    noise_free: bool = False
    soak_k: float = 0.0
    session_s: tuple[float, float] = (0.0, 60.0)  # start and end of the session, since power-up

    def arguments(self) -> list[str]:
        """Return the options as arguments of `gyrorigd emulate`."""
        words = ["--from", repr(self.session_s[0]), "--until", repr(self.session_s[1])]
        for text in self.hide:
            words += ["--hide", text]
        if self.seed is not None:
            words += ["--seed", str(self.seed)]
        if self.session_seed is not None:
            words += ["--session-seed", str(self.session_seed)]
        if self.draw:
            words += ["--draw", str(self.draw)]
        if self.twin_recording is not None:
            words += ["--twin-recording", self.twin_recording]
        if self.truth is not None:
            words += ["--truth", str(self.truth)]
        if self.noise_free:
            words.append("--noise-free")
        if self.soak_k != 0.0:
            words += ["--soak", repr(self.soak_k)]
        return words


def replay_begin_s(settings: PtuSettings) -> float:
    """Return when a replay begins, in seconds after power-up of an emulated rig.

    The unit is ready by then, so that the recorded orders have one place on the time axis of a
    twin.
    """
    return _PREPARATION_S + (_TABLE_UPDATE_S if settings != PtuSettings() else 0.0)


def estimate_session_s(program: MotionProgram, is_manual: bool = False) -> tuple[float, float]:
    """Return the approximate start and end of a session in seconds since power-up.

    Single events of hidden causes are placed between the two. A person executes a program with
    `is_manual`.
    """
    if is_manual:
        steps = unroll_manual_steps(program.steps, program.name)
        return 0.0, sum(step.seconds + _PAUSE_S for step in steps)
    begin_s = _TABLE_UPDATE_S if program.settings != PtuSettings() else 0.0
    acceleration_deg_s2 = program.settings.acceleration_deg_s2 or _ACCELERATION_DEG_S2
    total_s = begin_s
    default_deg_s = program.settings.default_speed_deg_s
    position_deg = {"pan": 0.0, "tilt": 0.0}
    for step in unroll_steps(program.steps, program.name):
        if isinstance(step, Rest):
            total_s += step.seconds
            continue
        home = Move(pan_deg=0.0, tilt_deg=0.0, speed_deg_s=step.speed_deg_s)
        move = home if isinstance(step, Home) else step
        duration_s = 0.0
        for axis, to_deg, axis_speed_deg_s in (
            ("pan", move.pan_deg, move.pan_speed_deg_s),
            ("tilt", move.tilt_deg, move.tilt_speed_deg_s),
        ):
            if to_deg is not None:
                distance_deg, position_deg[axis] = abs(to_deg - position_deg[axis]), to_deg
                speed_deg_s = axis_speed_deg_s or move.speed_deg_s or default_deg_s
                ramp_s = speed_deg_s / acceleration_deg_s2
                duration_s = max(duration_s, distance_deg / speed_deg_s + ramp_s)
        total_s += duration_s + move.settle_s
    return begin_s, total_s
