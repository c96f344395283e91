"""Acceleration-sensitive drift rate (g-sensitivity): G f, with f the specific force at rest.

Size: about 0.1 deg/s per g is common for MEMS gyroscopes.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    SENSOR_AXES,
    CarriedCause,
    FloatArray,
    InjectedCause,
    ParameterSampling,
    Quantity,
    SensorCause,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.board_effects import MotionSamples
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


@dataclass(frozen=True, slots=True, eq=False)
class GSensitivity(SensorCause):
    """The specific force adds to the output, along a separate direction for each axis."""

    name = "g_sensitivity"
    size_meaning = "rate per acceleration on each axis"
    unit = "(rad/s)/(m/s^2)"
    typical = 1.8e-4
    sampled_min, sampled_max = 3e-5, 1e-3
    max_size = 0.1

    matrix: FloatArray  # rad/s per m/s^2, sensor axes, (3, 3)

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        rows = sampling.rng.standard_normal((3, 3))
        rows = sampling.size * rows / np.linalg.norm(rows, axis=1, keepdims=True)
        if sampling.component:
            rows *= (np.array(SENSOR_AXES) == sampling.component)[:, None]
        names = [f"{output}{along}" for output in SENSOR_AXES for along in SENSOR_AXES]
        unit = "(rad/s)/(m/s^2)"
        return {n: Quantity(v, unit) for n, v in zip(names, rows.ravel().tolist(), strict=True)}

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; the force of findings is in axes of the stage."""
        unit = "(rad/s)/(m/s^2)"
        names = [f"{output}{along}" for output in SENSOR_AXES for along in SENSOR_AXES]
        stage_rows = np.reshape([stated.number(f"sensitivity.{n}", 0.0) for n in names], (3, 3))
        rows = stage_rows @ stated.on_board.mounting.T
        values = zip(names, rows.ravel().tolist(), strict=True)
        return (CarriedCause({name: Quantity(value, unit) for name, value in values}),)

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        rows = [
            [injected.number(f"{output}{along}") for along in SENSOR_AXES] for output in SENSOR_AXES
        ]
        injected.board_hooks(hooks).rate_effects.append(cls(np.array(rows)))

    def added_rad_s(self, samples: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        return np.asarray(samples.force_m_s2 @ self.matrix.T)
