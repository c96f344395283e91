"""Where effects hang on a rig: an empty `RigHooks` is a rig without any.

Causes fill it (`causes`), the rig's parts take it.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.motor import AngleEffect, StepEffect
from gyrorig_daemon.emulator.physics.effects.sensor import (
    BiasEffect,
    CountEffect,
    MountEffect,
    RateEffect,
)
from gyrorig_daemon.emulator.physics.effects.slip import Slip
from gyrorig_daemon.emulator.physics.effects.timing import Jitter, Lag
from gyrorig_daemon.emulator.physics.effects.words import Lost

FloatArray = NDArray[np.float64]


@dataclass(slots=True)
class AxisHooks:
    """What is wrong with an axis of the unit."""

    scale_error: float = 0.0
    acceleration_error: float = 0.0
    base_speed_added_rad_s: float = 0.0
    s_curve_s: float = 0.0
    slip: Slip | None = None
    gap_rad: float = 0.0
    steps: list[StepEffect] = field(default_factory=list)  # between motor and gear, besides the gap
    angles: list[AngleEffect] = field(default_factory=list)


@dataclass(slots=True)
class BoardHooks:
    """What is wrong with a board."""

    tau_added_s: float = 0.0
    bandwidth_factor: float = 1.0
    count_factor: float = 1.0  # true counts = those of the told full scale x this
    limit_rad_s: FloatArray | None = None  # what a sample can show at most, (3,)
    lags: list[Lag] = field(default_factory=list)
    jitter: Jitter | None = None
    mounts: list[MountEffect] = field(default_factory=list)
    rates: list[RateEffect] = field(default_factory=list)
    biases: list[BiasEffect] = field(default_factory=list)
    words: list[CountEffect] = field(default_factory=list)
    lost: Lost | None = None

    def lag(self, time_s: float) -> tuple[float, float]:
        """Return the lag of a block that begins at a time, and its growth, over all causes."""
        told = [lag.at(time_s) for lag in self.lags]
        return sum(lag for lag, _ in told), sum(growth for _, growth in told)


@dataclass(slots=True)
class RigHooks:
    """What is wrong with a rig."""

    pan: AxisHooks = field(default_factory=AxisHooks)
    tilt: AxisHooks = field(default_factory=AxisHooks)
    tilt_axis_error_rad: float = 0.0
    ground_rate_rad_s: FloatArray | None = None
    boards: dict[str, BoardHooks] = field(default_factory=dict)

    def axis(self, name: str) -> AxisHooks:
        """Return the hooks of `pan` or `tilt`."""
        return self.pan if name == "pan" else self.tilt

    def board(self, name: str) -> BoardHooks:
        """Return the hooks of a board."""
        return self.boards.setdefault(name, BoardHooks())
