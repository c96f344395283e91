"""How a move's position changes with what is not known of it.

The first start of a move only shifts it; everything else is found by central differences
of the course itself, which is exact to 1e-7 of the effect and holds for any orders.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.reference.course import Course
from gyrorig_solver.reference.moves import Move

_LOG_STEP = 1e-4
_TIME_STEP_S = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Derivatives of a move's position at some times, each column of the times' shape."""

    starts: FloatArray  # (orders, n), steps/s
    speeds: FloatArray  # (classes of the move, n), steps per log speed
    acceleration: FloatArray  # (n,), steps per log acceleration


def slopes(
    move: Move,
    starts_s: FloatArray,
    log_speed: FloatArray,
    log_acceleration: float,
    time_s: FloatArray,
) -> Slopes:
    """Return the derivatives of `move.course(...)` at times."""

    def change(higher: Course, lower: Course, step: float) -> FloatArray:
        difference = higher.position_steps(time_s) - lower.position_steps(time_s)
        return np.asarray(difference / (2.0 * step), dtype=np.float64)

    here = move.course(starts_s, log_speed, log_acceleration)
    if len(move.orders) == 1:
        starts = -here.speed_steps_s(time_s)[None, :]
    else:
        starts = np.empty((len(move.orders), time_s.size))
        for k in range(len(move.orders)):
            step = np.zeros(len(move.orders))
            step[k] = _TIME_STEP_S
            starts[k] = change(
                move.course(starts_s + step, log_speed, log_acceleration),
                move.course(starts_s - step, log_speed, log_acceleration),
                _TIME_STEP_S,
            )
    speeds = np.empty((len(move.classes), time_s.size))
    for row, speed_class in enumerate(move.classes):
        step = np.zeros(log_speed.size)
        step[speed_class] = _LOG_STEP
        speeds[row] = change(
            move.course(starts_s, log_speed + step, log_acceleration),
            move.course(starts_s, log_speed - step, log_acceleration),
            _LOG_STEP,
        )
    acceleration = change(
        move.course(starts_s, log_speed, log_acceleration + _LOG_STEP),
        move.course(starts_s, log_speed, log_acceleration - _LOG_STEP),
        _LOG_STEP,
    )
    return Slopes(starts, speeds, acceleration)
