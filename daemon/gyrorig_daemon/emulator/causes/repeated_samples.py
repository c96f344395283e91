"""Repeated samples: a register that is read again before a new sample is ready.

Observed when a driver polls faster than the output data rate, for example 1250 messages per
second of which 1000 are new (github.com/PX4/PX4-Autopilot, issue 14860).
"""

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.causes.cause import Cause, InjectedCause
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks

IntArray = NDArray[np.int64]


class RepeatedSamples(Cause):
    """At random, a sample repeats the counts of the sample before it."""

    name = "repeated_samples"
    size_meaning = "share of the samples that repeat the previous counts"
    part = "clock"
    unit = "1"
    typical = 1e-2
    sampled_min, sampled_max = 2e-3, 5e-2
    max_size = 0.5
    parameter = "share"
    is_signed = False

    def __init__(self, share: float, rng: np.random.Generator) -> None:
        """Repeat a share of the samples."""
        self._share, self._rng = share, rng
        self._is_repeated = np.zeros(0, dtype=np.bool_)
        self._previous: IntArray | None = None  # the last counts of the block before
        self._last: IntArray | None = None

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        injected.board_hooks(hooks).count_effects.append(cls(injected.number("share"), rng))

    def draw(self, count: int) -> None:
        """See `board_effects.CountEffect`."""
        self._is_repeated = self._rng.random(count) < self._share
        self._previous = self._last

    def changed(self, counts: IntArray) -> IntArray:
        """See `board_effects.CountEffect`."""
        first = counts[:1] if self._previous is None else self._previous
        candidates = np.vstack([first, counts])
        fresh = np.where(self._is_repeated, 0, np.arange(1, len(counts) + 1))
        read = candidates[np.maximum.accumulate(fresh)]
        self._last = read[-1:].copy()
        return read
