"""Directed Perception commands as neutral orders: kinds, axes, values, and the speed mode."""

import math

import pytest

from gyrorig_protocol.motion_orders import AxisOrder, OrderAxis, OrderKind
from gyrorig_protocol.ptu import MotionTranslator

PAN, TILT, BOTH = OrderAxis.PAN, OrderAxis.TILT, OrderAxis.BOTH


def orders(text: str, accepted: bool = True) -> list[tuple[str, str, float]]:
    made = MotionTranslator().translate(text, accepted)
    return [(order.kind.name, order.axis.name, order.value) for order in made]


@pytest.mark.parametrize(
    ("text", "kind", "axis", "value"),
    [
        ("PP-1200 ", "TARGET", "PAN", -1200.0),
        ("to35", "OFFSET", "TILT", 35.0),
        ("PS1000", "SPEED", "PAN", 1000.0),
        ("TD-20", "SPEED_CHANGE", "TILT", -20.0),
        ("PA2000", "ACCELERATION", "PAN", 2000.0),
        ("TB57", "BASE_SPEED", "TILT", 57.0),
        ("H", "HALT", "BOTH", 0.0),
        ("HP", "HALT", "PAN", 0.0),
        ("R", "HOME", "BOTH", 0.0),
        ("RT", "HOME", "TILT", 0.0),
        ("S", "COLLECT", "BOTH", 0.0),
        ("A", "START", "BOTH", 0.0),
        ("I", "IMMEDIATE", "BOTH", 0.0),
        ("WPE", "RESOLUTION", "PAN", 0.0),
    ],
)
def test_commands(text: str, kind: str, axis: str, value: float) -> None:
    assert orders(text) == [(kind, axis, value)]


@pytest.mark.parametrize("text", ["PP", "V", "BT", "FT", "ED", "CI", "PR", "L", "", "PP9" * 30])
def test_queries_and_modes_move_nothing(text: str) -> None:
    assert orders(text) == []


def test_a_command_to_both_axes_has_the_speed_in_its_targets() -> None:
    assert MotionTranslator().translate("B100,-20,300,400", True) == (
        AxisOrder(OrderKind.TARGET, PAN, 100.0, 300.0),
        AxisOrder(OrderKind.TARGET, TILT, -20.0, 400.0),
    )
    (target,) = MotionTranslator().translate("PP100", True)
    assert math.isnan(target.speed_steps_s)


def test_the_velocity_mode_makes_rates_of_speeds() -> None:
    translator = MotionTranslator()
    assert translator.translate("CV", accepted=False) == ()
    assert translator.translate("PS5", True)[0].kind is OrderKind.SPEED
    assert translator.translate("CV", True) == (AxisOrder(OrderKind.HALT, BOTH),)
    assert translator.translate("CV", True) == ()
    assert translator.translate("PS-5", True) == (AxisOrder(OrderKind.RATE, PAN, -5.0),)
    assert translator.translate("PD5", True)[0].kind is OrderKind.RATE_CHANGE
    assert translator.translate("CI", True) == (AxisOrder(OrderKind.HALT, BOTH),)
    assert translator.translate("PS5", True)[0].kind is OrderKind.SPEED
