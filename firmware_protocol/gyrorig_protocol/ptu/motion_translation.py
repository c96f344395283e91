"""Directed Perception commands as neutral orders of motion.

What to use when: `MotionTranslator.translate` for every command in the order of time, by the driver
for a recording that it makes, and by the reader of a recording without neutral orders. Nothing
else interprets these commands as motion. Source: command reference manual v3.00D.
"""

import re

from gyrorig_protocol.motion_orders import AxisOrder, OrderAxis, OrderKind

_NUMBER = r"([-+]?\d{1,15})"
_SETTING = re.compile(rf"([PT])([SABPOD]){_NUMBER}")
_BOTH = re.compile(rf"B{_NUMBER},{_NUMBER},(\d{{1,15}}),(\d{{1,15}})")
_STEP_MODE = re.compile(r"W([PT])[FHQEA]")
_AXES = {"P": OrderAxis.PAN, "T": OrderAxis.TILT, "": OrderAxis.BOTH}
_KINDS = {
    "P": OrderKind.TARGET,
    "O": OrderKind.OFFSET,
    "S": OrderKind.SPEED,
    "D": OrderKind.SPEED_CHANGE,
    "A": OrderKind.ACCELERATION,
    "B": OrderKind.BASE_SPEED,
}
_RATE_KINDS = {  # in the velocity mode
    OrderKind.SPEED: OrderKind.RATE,
    OrderKind.SPEED_CHANGE: OrderKind.RATE_CHANGE,
}
_PLAIN = {
    "S": AxisOrder(OrderKind.COLLECT, OrderAxis.BOTH),
    "A": AxisOrder(OrderKind.START, OrderAxis.BOTH),
    "I": AxisOrder(OrderKind.IMMEDIATE, OrderAxis.BOTH),
    **{f"H{letter}": AxisOrder(OrderKind.HALT, axis) for letter, axis in _AXES.items()},
    **{f"R{letter}": AxisOrder(OrderKind.HOME, axis) for letter, axis in _AXES.items()},
}


class MotionTranslator:
    """Translates commands; it remembers the speed mode of the unit."""

    def __init__(self) -> None:
        """Start in the mode in which speeds and targets are independent, as after power-up."""
        self._is_velocity_mode = False

    def translate(self, text: str, accepted: bool) -> tuple[AxisOrder, ...]:
        """Return the orders in a command, none if the command moves nothing.

        Args:
            text: the command, with or without its delimiter.
            accepted: the unit has accepted it; a refused command does not change the mode.
        """
        text = text.strip().upper()
        if plain := _PLAIN.get(text):
            return (plain,)
        if match := _SETTING.fullmatch(text):
            kind = _KINDS[match[2]]
            if self._is_velocity_mode:
                kind = _RATE_KINDS.get(kind, kind)
            return (AxisOrder(kind, _AXES[match[1]], float(match[3])),)
        if match := _BOTH.fullmatch(text):
            return tuple(
                AxisOrder(OrderKind.TARGET, axis, float(match[1 + k]), float(match[3 + k]))
                for k, axis in enumerate((OrderAxis.PAN, OrderAxis.TILT))
            )
        if match := _STEP_MODE.fullmatch(text):
            return (AxisOrder(OrderKind.RESOLUTION, _AXES[match[1]]),)
        if text in ("CI", "CV") and accepted:
            return self._change_mode(text == "CV")
        return ()

    def _change_mode(self, to_velocity: bool) -> tuple[AxisOrder, ...]:
        """A change of the speed mode halts both axes."""
        if to_velocity == self._is_velocity_mode:
            return ()
        self._is_velocity_mode = to_velocity
        return (AxisOrder(OrderKind.HALT, OrderAxis.BOTH),)
