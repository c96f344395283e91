"""Integral of the rates of a gyro over a turn.

What to use when: `integrate_turn` for one turn of one recording.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.link_remedies import RESTART
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.rest_mean import samples_in
from gyrorig_solver.reference.known_turns import KnownTurn

# Between two usable samples of a turn, or from its ends to the nearest one: the integral is a
# straight line there.
MAX_GAP_S, MAX_GAP_PERIODS = 0.1, 3.0
# The first sample of a turn can be later than its begin by this many periods without a gap.
MAX_END_PERIODS = 1.5
EDGE_SAMPLES = 4  # whose mean is the rate at an end of a turn; of the 8 or more in a turn


@dataclass(frozen=True, slots=True, eq=False)
class IntegratedTurn:
    """One turn as measured by the gyro."""

    recording: int
    turn: KnownTurn
    integral: FloatArray  # (3,), rad, with the bias
    span_s: float
    edge_rate_rad_s: FloatArray  # (2, 3), at the begin and at the end
    period_s: float


def integrate_turn(recording: int, samples: GyroSamples, turn: KnownTurn) -> IntegratedTurn:
    """Return the integral of the rates over a turn.

    Args:
        recording: the number of the recording in the fit.
        samples: of the recording.
        turn: on the time axis of the samples.

    Raises:
        InputError: the turn has too few samples, a gap, or a reset of the board.
    """
    index = samples_in(samples, turn.interval)
    if index.size < 8:
        raise InputError(
            f"the turn at {turn.interval.begin_s:.1f} s has only {index.size} usable samples, and "
            "8 are needed",
            "correct the start and the end of the turn in the import map, or remove the turn. Then "
            "import the data again",
        )
    if np.any(np.diff(samples.segment[index]) != 0):
        raise InputError(
            f"the times of the samples are interrupted during the turn at "
            f"{turn.interval.begin_s:.1f} s, by a restart, a step of the clock or a pause",
            RESTART.for_link(samples.link),
        )
    time_s, rate = samples.time_s[index], samples.rate_rad_s[index]
    bounds_s = np.concatenate([[turn.interval.begin_s], time_s, [turn.interval.end_s]])
    longest_gap_s = float(np.diff(bounds_s).max())
    if longest_gap_s > max(MAX_GAP_S, MAX_GAP_PERIODS * samples.period_s):
        raise InputError(
            f"the turn at {turn.interval.begin_s:.1f} s has no usable sample for "
            f"{longest_gap_s:.2g} s, because samples are lost or at full scale, so its total angle "
            "is not known",
            "turn more slowly or use a larger full scale, and record the turn again, or remove it "
            "from the import map",
        )
    # Half a period is added at both ends, because n samples represent n periods. In a short gap at
    # an end, the rate is that of the nearest sample.
    begin_gap_s, end_gap_s = (
        gap_s if gap_s > MAX_END_PERIODS * samples.period_s else 0.0
        for gap_s in (bounds_s[1] - bounds_s[0], bounds_s[-1] - bounds_s[-2])
    )
    added_s = np.array([[0.5 * samples.period_s + gap_s] for gap_s in (begin_gap_s, end_gap_s)])
    integral = np.trapezoid(rate, time_s, axis=0) + np.sum(added_s * rate[[0, -1]], axis=0)
    duration_s = float(time_s[-1] - time_s[0] + added_s.sum())
    edge_rate = np.array([rate[:EDGE_SAMPLES].mean(axis=0), rate[-EDGE_SAMPLES:].mean(axis=0)])
    return IntegratedTurn(recording, turn, integral, duration_s, edge_rate, samples.period_s)
