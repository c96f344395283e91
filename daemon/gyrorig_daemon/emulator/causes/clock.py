"""Causes in a board's timing. Sizes: rig discovery survey, section 2; timing survey, 9."""

import math

import numpy as np

from gyrorig_daemon.emulator.causes.cause import Cause, Draw, Hidden, Quantity, board_of
from gyrorig_daemon.emulator.physics.effects.hooks import RigHooks
from gyrorig_daemon.emulator.physics.effects.timing import Jitter, SkewLag, StepLag
from gyrorig_daemon.emulator.physics.effects.words import Lost, Stale
from gyrorig_daemon.emulator.settings import BoardSettings

_LONGEST_GAP = 3  # samples


def _offset(draw: Draw) -> dict[str, Quantity]:
    return {"lag": Quantity(draw.size, "s")}


def _hang_offset(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    board_of(hidden, hooks).tau_added_s += hidden.number("lag")


def _skew(draw: Draw) -> dict[str, Quantity]:
    # A lag that shrinks has to last longer than the session.
    start_s = max(-draw.size, 0.0) * (1.3 * draw.rig.session_s[1] + 10.0)
    return {"lag_growth": Quantity(draw.size, "1"), "lag_at_power_up": Quantity(start_s, "s")}


def _hang_skew(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    lag = SkewLag(hidden.number("lag_growth"), hidden.number("lag_at_power_up"))
    board_of(hidden, hooks).lags.append(lag)


def _step(draw: Draw) -> dict[str, Quantity]:
    return {"step": Quantity(draw.size, "s"), "at": Quantity(draw.event_s(), "s")}


def _hang_step(hidden: Hidden, hooks: RigHooks, _rng: np.random.Generator) -> None:
    board_of(hidden, hooks).lags.append(StepLag(hidden.number("step"), hidden.number("at")))


def _share(draw: Draw) -> dict[str, Quantity]:
    return {"share": Quantity(draw.size, "1")}


def _hang_lost(hidden: Hidden, hooks: RigHooks, rng: np.random.Generator) -> None:
    board_of(hidden, hooks).lost = Lost(hidden.number("share"), _LONGEST_GAP, rng)


def _hang_repeated(hidden: Hidden, hooks: RigHooks, rng: np.random.Generator) -> None:
    board_of(hidden, hooks).words.append(Stale(hidden.number("share"), rng))


def _jitter(draw: Draw) -> dict[str, Quantity]:
    mean_lag_s = 0.5 * math.sqrt(12.0) * draw.size
    return {"rms": Quantity(draw.size, "s"), "mean_lag": Quantity(mean_lag_s, "s")}


def _most_jitter_s(board: BoardSettings) -> float:
    """No sample may be as old as the one before; sensors run up to 5 % fast."""
    return 0.95 / board.odr_hz / math.sqrt(12.0)


def _hang_jitter(hidden: Hidden, hooks: RigHooks, rng: np.random.Generator) -> None:
    board_of(hidden, hooks).jitter = Jitter(hidden.number("rms"), rng)


CAUSES = (
    Cause(
        "clock_offset", "how much later a sample shows the motion",
        "clock", "s", 5e-3, 1e-3, 20e-3, 0.2, _offset, _hang_offset, signed=False
    ),
    Cause(
        "clock_skew", "growth of the samples' lag, in s per s",
        "clock", "1", 2e-4, 2e-5, 1e-3, 5e-3, _skew, _hang_skew,
    ),
    Cause(
        "clock_step", "by how much the samples' lag jumps, once",
        "clock", "s", 10e-3, 1e-3, 30e-3, 0.2, _step, _hang_step,
    ),
    Cause(
        "lost_samples", "share of the samples that never come",
        "clock", "1", 5e-3, 1e-3, 2e-2, 0.2, _share, _hang_lost, signed=False
    ),
    Cause(
        "repeated_samples", "share of the samples that are the words of the one before",
        "clock", "1", 1e-2, 2e-3, 5e-2, 0.5, _share, _hang_repeated,
        signed=False,
    ),
    Cause(
        "sample_jitter", "scatter of the samples' instants (rms)",
        "clock", "s", 1e-3, 3e-4, 2.5e-3, 1e-2, _jitter, _hang_jitter,
        signed=False, most_on=_most_jitter_s,
    ),
)  # fmt: skip
