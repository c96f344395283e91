"""Orders of a motion unit, without the words of any maker.

What to use when: a driver describes each command that it sends by `AxisOrder`s; the recorder writes
them as `MotionOrder` messages; the solver reconstructs the motion from them. Values are in steps,
the unit in which the driver counts an axis.
"""

import math
from dataclasses import dataclass
from enum import IntEnum


class OrderKind(IntEnum):
    """What an order does; the value is its number in a recording."""

    TARGET = 0  # move to a position, in steps
    OFFSET = 1  # move by a distance from the present position, in steps
    SPEED = 2  # speed of moves, in steps/s
    SPEED_CHANGE = 3  # change of the speed of moves, in steps/s
    RATE = 4  # turn without a target until the end of travel, in signed steps/s; 0 stops
    RATE_CHANGE = 5  # change of that rate, in steps/s
    BASE_SPEED = 6  # speed that is reached without a ramp, in steps/s
    ACCELERATION = 7  # above the base speed, in steps/s^2
    HALT = 8  # decelerate and stop
    COLLECT = 9  # targets from now on wait for START or IMMEDIATE
    START = 10  # start the targets that wait; later ones wait, too
    IMMEDIATE = 11  # start the targets that wait; later ones start at once
    HOME = 12  # search the zero; the count is 0 afterwards
    RESOLUTION = 13  # the size of a step changes


class OrderAxis(IntEnum):
    """The axis of an order; the value is its number in a recording."""

    PAN = 0
    TILT = 1
    BOTH = 2


@dataclass(frozen=True, slots=True)
class AxisOrder:
    """One order; a command of a unit can consist of several.

    Attributes:
        kind: what it does.
        axis: which axis.
        value: in steps, steps/s or steps/s^2 as the kind says; 0 for a kind without a value.
        speed_steps_s: speed that belongs to a target; NaN if the order has none.
    """

    kind: OrderKind
    axis: OrderAxis
    value: float = 0.0
    speed_steps_s: float = math.nan
