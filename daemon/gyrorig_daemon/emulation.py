"""What a command line wants of an emulated rig. The emulator itself is imported only then."""

from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.program import Home, MotionProgram, Move, Rest, UnitSettings, unrolled

_SETTLING_S = 12.5  # a unit computes its tables anew for each base speed and acceleration
_ACCELERATION_DEG_S2 = 100.0  # of a unit that is left as it is


@dataclass(frozen=True, slots=True)
class Emulation:
    """What a command line wants of an emulated rig, besides its configuration."""

    seed: int | None = None  # instead of the configuration's own
    truth: Path | None = None
    rates: Path | None = None  # see `emulator.noise_free`
    hide: tuple[str, ...] = ()  # see `causes.parse_hide`
    noise_free: bool = False
    soak_k: float = 0.0
    session_s: tuple[float, float] = (0.0, 60.0)  # when it is used, since power-up

    def arguments(self) -> list[str]:
        """Return the same as arguments of `gyrorigd emulate`."""
        words = ["--from", repr(self.session_s[0]), "--until", repr(self.session_s[1])]
        for text in self.hide:
            words += ["--hide", text]
        if self.seed is not None:
            words += ["--seed", str(self.seed)]
        if self.truth is not None:
            words += ["--truth", str(self.truth)]
        if self.noise_free:
            words.append("--noise-free")
        if self.soak_k != 0.0:
            words += ["--soak", repr(self.soak_k)]
        return words


def rough_session_s(program: MotionProgram) -> tuple[float, float]:
    """Return about when a session begins and ends, since power-up: for what comes in its middle."""
    begin_s = _SETTLING_S if program.settings != UnitSettings() else 0.0
    acceleration_deg_s2 = program.settings.acceleration_deg_s2 or _ACCELERATION_DEG_S2
    total_s = begin_s
    default_deg_s = program.settings.default_speed_deg_s
    at = {"pan": 0.0, "tilt": 0.0}
    for step in unrolled(program.steps, program.name):
        if isinstance(step, Rest):
            total_s += step.seconds
            continue
        home = Move(pan_deg=0.0, tilt_deg=0.0, speed_deg_s=step.speed_deg_s)
        move = home if isinstance(step, Home) else step
        lasts_s = 0.0
        for axis, to_deg, own_deg_s in (
            ("pan", move.pan_deg, move.pan_speed_deg_s),
            ("tilt", move.tilt_deg, move.tilt_speed_deg_s),
        ):
            if to_deg is not None:
                way_deg, at[axis] = abs(to_deg - at[axis]), to_deg
                speed_deg_s = own_deg_s or move.speed_deg_s or default_deg_s
                ramp_s = speed_deg_s / acceleration_deg_s2
                lasts_s = max(lasts_s, way_deg / speed_deg_s + ramp_s)
        total_s += lasts_s + move.settle_s
    return begin_s, total_s
