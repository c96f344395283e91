"""Rate random walk: K times a Wiener process, in addition to the random walk of every sensor."""

import math

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    FloatArray,
    InjectedCause,
    ParameterSampling,
    Quantity,
    SensorCause,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks
from gyrorig_daemon.emulator.physics.temperature import BoardTemperature

_KNOT_S = 0.1
_MIN_KNOTS = 1024  # sampled at a time, so that the whole path is copied rarely


class BiasRandomWalk(SensorCause):
    """The bias follows a random walk, linear between knots that are sampled once, in order."""

    name = "bias_random_walk"
    size_meaning = "largest rate random walk coefficient, in addition to that of the sensor"
    unit = "rad/s/sqrt(s)"
    typical = 5e-5
    sampled_min, sampled_max = 2e-5, 2e-4
    max_size = 1e-2
    is_signed = False

    def __init__(self, walk_rad_s_rts: FloatArray, rng: np.random.Generator) -> None:
        """Start at zero.

        Args:
            walk_rad_s_rts: standard deviation after one second, (3,).
            rng: source of the increments.
        """
        self._step = walk_rad_s_rts * math.sqrt(_KNOT_S)
        self._rng = rng
        self._knots = np.zeros((1, 3))

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        walk = (abs(number) for number in sampling.by_axis("rad/s/sqrt(s)").array.tolist())
        return {"walk": Quantity(tuple(walk), "rad/s/sqrt(s)")}

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; the noise levels of the board contain the walk."""
        return ()

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        injected.board_hooks(hooks).bias_effects.append(cls(injected.array("walk"), rng))

    def added_rad_s(self, time_s: FloatArray, temperature: BoardTemperature) -> FloatArray:
        """See `board_effects.BiasEffect`."""
        position = np.maximum(time_s, 0.0) / _KNOT_S
        missing = int(position.max()) + 2 - len(self._knots)
        if missing > 0:
            steps = self._step * self._rng.standard_normal((max(missing, _MIN_KNOTS), 3))
            self._knots = np.vstack([self._knots, self._knots[-1] + np.cumsum(steps, axis=0)])
        knot = position.astype(np.int64)
        fraction = (position - knot)[:, None]
        return np.asarray((1.0 - fraction) * self._knots[knot] + fraction * self._knots[knot + 1])
