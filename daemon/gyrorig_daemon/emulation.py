"""What a command line wants of an emulated rig. The emulator itself is imported only then."""

from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.program import Home, MotionProgram, Move, Rest, UnitSettings, unrolled

_SETTLING_S = 12.0  # a unit computes its tables anew for each base speed and acceleration


@dataclass(frozen=True, slots=True)
class Emulation:
    """What a command line wants of an emulated rig, besides its configuration."""

    seed: int | None = None  # instead of the configuration's own
    truth: Path | None = None
    hide: tuple[str, ...] = ()  # see `causes.parse_hide`
    noise_free: bool = False
    soak_k: float = 0.0
    about_s: float = 60.0  # how long the session will last

    def arguments(self) -> list[str]:
        """Return the same as arguments of `gyrorigd emulate`."""
        words = ["--about", repr(self.about_s)]
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


def rough_duration_s(program: MotionProgram) -> float:
    """Return about how long a session with a program lasts, for what happens in its middle."""
    total_s = _SETTLING_S if program.settings != UnitSettings() else 0.0
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
                lasts_s = max(lasts_s, way_deg / (own_deg_s or move.speed_deg_s or default_deg_s))
        total_s += lasts_s + move.settle_s
    return total_s
