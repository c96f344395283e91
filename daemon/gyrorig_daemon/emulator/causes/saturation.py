"""Saturation: the output is clipped at a rate below the full scale."""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    SENSOR_AXES,
    CarriedCause,
    InjectedCause,
    ParameterSampling,
    Quantity,
    SensorCause,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


class Saturation(SensorCause):
    """The absolute output never exceeds a limit."""

    name = "saturation"
    size_meaning = "largest rate that the output can show"
    unit = "rad/s"
    typical = 1.2
    sampled_min, sampled_max = 0.8, 1.7
    max_size = 100.0
    is_signed = False
    min_size = 0.01
    neutral_size = 100.0

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        return {"limit": Quantity(sampling.size, "rad/s")}

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; the raw counts show a limit, a fit the shortfall from the full scale."""
        full_scale_rad_s = stated.on_board.full_scale_rad_s
        limit_rad_s = stated.number(
            "limit", full_scale_rad_s * (1.0 - stated.number("shortfall", 0.0))
        )
        parameters = {"limit": Quantity(limit_rad_s, "rad/s")}
        return tuple(CarriedCause(parameters, axis) for axis in stated.places or SENSOR_AXES)

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        board = injected.board_hooks(hooks)
        limit = np.full(3, np.inf) if board.limit_rad_s is None else board.limit_rad_s
        is_limited = [axis in injected.components for axis in SENSOR_AXES]
        board.limit_rad_s = np.where(is_limited, np.minimum(limit, injected.number("limit")), limit)
