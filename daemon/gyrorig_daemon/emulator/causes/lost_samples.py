"""Lost samples: short gaps in the stream, visible in the sequence numbers."""

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    Cause,
    InjectedCause,
    Quantity,
    StatedCause,
)
from gyrorig_daemon.emulator.causes.clock_step import ClockStep
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks

_LONGEST_GAP = 3  # samples


class LostSamples(Cause):
    """Samples are lost at random in short gaps; their sequence numbers are missing too."""

    name = "lost_samples"
    size_meaning = "share of the samples that are lost"
    part = "clock"
    unit = "1"
    typical = 5e-3
    sampled_min, sampled_max = 1e-3, 2e-2
    max_size = 0.2
    parameter = "share"
    is_signed = False

    def __init__(self, share: float, longest_gap: int, rng: np.random.Generator) -> None:
        """Lose a share of the samples, in gaps of 1 to `longest_gap` samples."""
        self._gap_probability = 2.0 * share / (1.0 + longest_gap)
        self._longest_gap, self._rng = longest_gap, rng
        self._remaining = 0  # of the gap that the last block has begun

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; uncounted losses make later timestamps too early, which is a clock step."""
        if stated.has("share"):
            return (CarriedCause({"share": Quantity(stated.number("share"), "1")}),)
        step_s = -stated.number("count") * stated.on_board.period_s
        return (
            CarriedCause(
                {"step": Quantity(step_s, "s"), "at": stated.event_s()},
                delay_s=max(-step_s, 0.0),
            ),
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        if "step" in injected.parameters:
            ClockStep.apply(injected, hooks, rng)
            return
        injected.board_hooks(hooks).lost = cls(injected.number("share"), _LONGEST_GAP, rng)

    def draw(self, count: int) -> NDArray[np.bool_]:
        """See `board_effects.SampleLoss`."""
        begins = self._rng.random(count) < self._gap_probability
        lengths = self._rng.integers(1, self._longest_gap + 1, count)
        is_lost = np.zeros(count, dtype=np.bool_)
        for k in range(count):
            if begins[k]:
                self._remaining = max(self._remaining, int(lengths[k]))
            is_lost[k] = self._remaining > 0
            self._remaining = max(self._remaining - 1, 0)
        return is_lost
