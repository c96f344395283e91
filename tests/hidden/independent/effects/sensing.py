"""Effects of the sensor itself: axes with different delays, and bursts of its bias."""

from dataclasses import dataclass

import numpy as np
from tests.bench.accuracy.profile import FloatArray
from tests.bench.rigs.stage_motion import StageMotion
from tests.hidden.independent.effects.effect import Effect, OutsideEffect, Site

Span = tuple[float, float]
BURSTS_PER_S = 0.2
BURST_S = (0.1, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class AxisDelays(Effect):
    """The axes are read at different instants."""

    lags_s: FloatArray  # (3,)

    def axis_lags_s(self) -> FloatArray:
        """Return the added lag of each axis."""
        return self.lags_s


@dataclass(frozen=True, slots=True, eq=False)
class Bursts(Effect):
    """The bias jumps for a short time and returns, at random instants (popcorn noise)."""

    jump_rad_s: FloatArray  # (3,)
    begins: FloatArray  # shares of the recording
    lengths_s: FloatArray

    def added_rates_rad_s(self, motion: StageMotion, span_s: Span) -> FloatArray:
        """Return the bias."""
        middle_s = motion.middle_s
        jumped = np.zeros(middle_s.size)
        for begin, length_s in zip(self.begins, self.lengths_s, strict=True):
            begin_s = span_s[0] + begin * (span_s[1] - span_s[0])
            first, last = np.searchsorted(middle_s, [begin_s, begin_s + length_s])
            jumped[first:last] = 1.0
        return np.outer(jumped, self.jump_rad_s)


def _make_axis_delays(site: Site) -> Effect:
    order = site.rng.permutation(3).astype(np.float64)
    return AxisDelays(site.size * order / 2.0)


def _make_bursts(site: Site) -> Effect:
    rng = site.rng
    count = max(3, round(BURSTS_PER_S * (site.span_s[1] - site.span_s[0])))
    jump = site.size * site.draw_direction()
    return Bursts(jump, np.sort(rng.uniform(size=count)), rng.uniform(*BURST_S, size=count))


SENSING = (
    OutsideEffect(
        "axis_delays", "the axes are read at different instants", "s", 1e-3, 0.01,
        ("pan_transient", "tilt_transient", "move_gain", "move_delay", "own_rate"),
        _make_axis_delays,
    ),
    OutsideEffect(
        "bursts", "the bias jumps for a short time and returns", "rad/s", 2e-3, 0.1,
        ("bias_time", "move_gain", "pan_transient", "tilt_transient"), _make_bursts,
    ),
)  # fmt: skip
