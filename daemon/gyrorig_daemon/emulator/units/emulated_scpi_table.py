"""Plays a rate table of one axis with SCPI-like text; it shares no code with the driver."""

import re
from dataclasses import replace

from gyrorig_daemon.emulator.emulator_settings import PtuSettings
from gyrorig_daemon.emulator.units.front_end import EmulatedTextUnit, FrontEnd

STEP_DEG = 1e-4
MAX_SPEED_DEG_S = 200.0
_NUMBER = re.compile(r"(POS|VEL|ACC) ([-+]?[0-9.]+)")
_NO_ERROR, _RANGE, _UNKNOWN = '0,"No error"', '-222,"Data out of range"', '-113,"Undefined header"'


class EmulatedScpiTable(EmulatedTextUnit):
    """Executes the commands of a line in turn; the replies to its queries are joined by `;`."""

    error = _NO_ERROR

    def reply(self, line: str, time_s: float) -> str | None:
        """See `EmulatedTextUnit`."""
        replies = [self._run(part.strip(" :").upper(), time_s) for part in line.split(";")]
        answered = [text for text in replies if text is not None]
        return ";".join(answered) if answered else None

    def _run(self, command: str, time_s: float) -> str | None:
        if command == "SYST:ERR?":
            error, self.error = self.error, _NO_ERROR
            return error
        if command.endswith("?"):
            return self._query(command, time_s)
        match = _NUMBER.fullmatch(command)
        if match is not None:
            if not self._set(match[1], float(match[2]), time_s):
                self.error = _RANGE
        elif command == "ABOR":
            self.pan.halt(time_s)
        elif command == "HOME":
            self.pan.move(time_s, 0.0)
        elif command not in ("OUTP ON", "MODE POS"):
            self.error = _UNKNOWN
        return None

    def _set(self, name: str, value: float, time_s: float) -> bool:
        if name == "POS":
            return self.pan.move(time_s, value)
        if value <= 0.0 or (name == "VEL" and value > MAX_SPEED_DEG_S):
            return False
        if name == "VEL":
            self.pan.speed_deg_s = value
        else:
            self.pan.acceleration_deg_s2 = value
        return True

    def _query(self, command: str, time_s: float) -> str | None:
        replies = {
            "*IDN?": f"EMULATED,RATE TABLE,{self.settings.serial},1.0",
            "POS?": f"{self.pan.position_deg(time_s):.4f}",
            "MOV?": str(int(self.pan.is_moving(time_s))),
            "POS:LIM:LOW?": f"{self.pan.lowest_deg:.3f}",
            "POS:LIM:HIGH?": f"{self.pan.highest_deg:.3f}",
            "VEL:MAX?": f"{MAX_SPEED_DEG_S:.1f}",
            "ACC?": f"{self.pan.acceleration_deg_s2:.4f}",
        }
        if command not in replies:
            self.error = _UNKNOWN
        return replies.get(command)


def _adjust(settings: PtuSettings) -> PtuSettings:
    return replace(
        settings,
        full_step_arcsec=STEP_DEG * 3600.0,
        step_mode="F",
        pan_min_steps=round(-360.0 / STEP_DEG),
        pan_max_steps=round(360.0 / STEP_DEG),
        tilt_min_steps=0,
        tilt_max_steps=0,
        base_speed_steps_s=0,
        speed_steps_s=round(30.0 / STEP_DEG),
        acceleration_steps_s2=round(100.0 / STEP_DEG),
        serial="RT-0001",
    )


FRONT_END = FrontEnd(EmulatedScpiTable, _adjust)
