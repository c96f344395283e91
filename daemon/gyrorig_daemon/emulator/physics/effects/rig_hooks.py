"""Hooks for effects: empty `RigHooks` are a rig without any.

Causes add their effects, and the parts of the rig use them.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.axis_effects import AngleEffect, StepEffect, StepLoss
from gyrorig_daemon.emulator.physics.effects.board_effects import (
    BiasEffect,
    CountEffect,
    JitterEffect,
    LagEffect,
    MountEffect,
    RateEffect,
    SampleLoss,
)

FloatArray = NDArray[np.float64]


@dataclass(slots=True)
class AxisHooks:
    """Effects on an axis of the unit."""

    scale_error: float = 0.0
    acceleration_error: float = 0.0
    base_speed_added_rad_s: float = 0.0
    s_curve_s: float = 0.0
    slips: list[StepLoss] = field(default_factory=list)
    # Makers take the angle of a step in rad. Their effects act before the others.
    step_effect_makers: list[Callable[[float], StepEffect]] = field(default_factory=list)
    step_effects: list[StepEffect] = field(default_factory=list)
    angle_effects: list[AngleEffect] = field(default_factory=list)


@dataclass(slots=True)
class BoardHooks:
    """Effects on a board."""

    tau_added_s: float = 0.0
    bandwidth_factor: float = 1.0
    count_factor: float = 1.0  # true counts = counts by the reported full scale x this
    limit_rad_s: FloatArray | None = None  # largest output, (3,)
    lags: list[LagEffect] = field(default_factory=list)
    jitter: JitterEffect | None = None
    mount_effects: list[MountEffect] = field(default_factory=list)
    rate_effects: list[RateEffect] = field(default_factory=list)
    bias_effects: list[BiasEffect] = field(default_factory=list)
    count_effects: list[CountEffect] = field(default_factory=list)
    lost: SampleLoss | None = None

    def lag(self, time_s: float) -> tuple[float, float]:
        """Return the total lag of a sample that is ready at a time, and its growth per second."""
        lags = [lag.at(time_s) for lag in self.lags]
        return sum(lag for lag, _ in lags), sum(growth for _, growth in lags)


@dataclass(slots=True)
class RigHooks:
    """Effects on a rig."""

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
