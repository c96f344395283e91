"""The check of one board in one recording: default simulation, twin and measurement.

What to use when: `check_board` for one board; `StageCheck` for the result of one simulation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data import FloatArray
from gyrorig_solver.twin_check.feature_comparison import (
    FamilyComparison,
    compare_families,
    upper_tail,
)
from gyrorig_solver.twin_check.observed_session import ObservedSession
from gyrorig_solver.twin_check.predicted_rates import SimulatedRates
from gyrorig_solver.twin_check.predictive_density import RateDensity, log_mean_exp
from gyrorig_solver.twin_check.received_noise import (
    ReceivedDensity,
    ReceivedNoise,
    SimulatedNoise,
    constant_signals,
    estimate_noise,
)
from gyrorig_solver.twin_check.session_features import session_features
from gyrorig_solver.twin_check.simulation import SimulatedRun

MIN_POSSIBLE_SIGMA = 5.0  # smallest distance to the ceiling for which a share is stated


@dataclass(frozen=True, slots=True, eq=False)
class StageCheck:
    """The comparison of the measurement with one simulation."""

    nats_per_s: float  # log predictive density of the measured rates
    # the same for each simulated session under the other draws, if its samples were those measured
    draws_nats_per_s: FloatArray
    ceiling_nats_per_s: float  # of the simulation's noise alone, at the measured samples
    ceiling_std_nats_per_s: float  # scatter of the same between sessions
    nats_by_draw: FloatArray  # log density of the measured rates under each draw, nats
    density_p_value: float  # probability that a simulated session is predicted worse
    comparisons: tuple[FamilyComparison, ...]
    predicted_rad_s: FloatArray  # noise-free rates of the best draw, (n, 3)
    residual_rad_s: FloatArray  # (n, 3), measured minus predicted, unknowns fitted
    draw_residual_rad_s: FloatArray  # the same of one simulated session


@dataclass(frozen=True, slots=True, eq=False)
class BoardCheck:
    """One board in one recording."""

    board: str
    recording: str
    sha256: str
    is_held_out: bool
    session: ObservedSession
    before: StageCheck
    without_causes: StageCheck | None  # None if the twin has no causes
    after: StageCheck

    @property
    def calibration_gain_nats_per_s(self) -> float:
        """Part of the gain that the twin also has without its causes."""
        return self.gain_nats_per_s - self.cause_gain_nats_per_s

    @property
    def cause_gain_nats_per_s(self) -> float:
        """Part of the gain that the causes add, 0 without causes."""
        if self.without_causes is None:
            return 0.0
        # The mean over fewer draws is lower, so both sides have the same number of draws.
        count = min(self.without_causes.nats_by_draw.size, self.after.nats_by_draw.size)
        after, without = (
            log_mean_exp(stage.nats_by_draw[:count]) for stage in (self.after, self.without_causes)
        )
        return (after - without) / self.session.duration_s

    @property
    def cause_share(self) -> tuple[float, float] | None:
        """Share of the distance from the twin without causes to the ceiling, and its scatter.

        The scatter comes from the ceiling, because the noise differs between sessions. None without
        causes, or if this scatter hides the distance.
        """
        if self.without_causes is None:
            return None
        gain, std = self.cause_gain_nats_per_s, self.after.ceiling_std_nats_per_s
        possible = self.after.ceiling_nats_per_s - self.after.nats_per_s + gain
        if possible <= MIN_POSSIBLE_SIGMA * std:
            return None
        return gain / possible, abs(gain) * std / possible**2

    @property
    def recovered_share(self) -> float | None:
        """Share of the distance to the ceiling by which the twin predicts better, or None."""
        possible = self.after.ceiling_nats_per_s - self.before.nats_per_s
        if possible <= 0.0:
            return None
        return (self.after.nats_per_s - self.before.nats_per_s) / possible

    @property
    def gain_nats_per_s(self) -> float:
        """Gain of the log predictive density by the twin."""
        return self.after.nats_per_s - self.before.nats_per_s


@dataclass(frozen=True, slots=True, eq=False)
class _Draw:
    """One simulated session of one board."""

    session: ObservedSession
    rates: SimulatedRates

    @property
    def noise_rad_s(self) -> FloatArray:
        return np.where(
            self.session.used[:, None], self.session.rate_rad_s - self.rates.own_rad_s, 0.0
        )


def check_board(
    measured: Recording,
    board: str,
    is_held_out: bool,
    before: Sequence[SimulatedRun],
    without_causes: Sequence[SimulatedRun],
    after: Sequence[SimulatedRun],
) -> BoardCheck:
    """Compare one board of a recording with the runs of all simulations.

    The first run of each simulation has its best parameters; the others are the draws.

    Args:
        measured: the recording.
        board: one of its boards.
        is_held_out: whether the twin was not fitted to this recording.
        before: runs of the default simulation.
        without_causes: runs of the twin without its causes; empty if it has none.
        after: runs of the twin.

    Raises:
        InputError: a recording cannot be compared; see `ObservedSession.of`.
    """
    session = ObservedSession.of(measured, board)
    return BoardCheck(
        board=board,
        recording=measured.path.name,
        sha256=measured.sha256,
        is_held_out=is_held_out,
        session=session,
        before=_check_stage(session, [_draw(run, board) for run in before]),
        without_causes=_check_stage(session, [_draw(run, board) for run in without_causes])
        if without_causes
        else None,
        after=_check_stage(session, [_draw(run, board) for run in after]),
    )


def _draw(run: SimulatedRun, board: str) -> _Draw:
    session = ObservedSession.of(run.recording, board)
    return _Draw(session, SimulatedRates.of(session, board, run.rates))


def _check_stage(session: ObservedSession, runs: Sequence[_Draw]) -> StageCheck:
    best, draws = runs[0], list(runs[1:])
    noise = estimate_noise(
        [run.noise_rad_s for run in runs],
        [run.session.block_samples for run in runs],
        session.sampling,
    )
    density = RateDensity(session, best.rates, noise)
    mean_nats_per_s = density.mean_log_density / session.duration_s
    by_draw = np.array([density.excess(draw.rates.at(session)) for draw in draws])
    by_draw += density.mean_log_density
    predicted = best.rates.at(session)
    residual = density.residual(predicted)
    limits: dict[str, tuple[float, float]] = {}
    offset = density.offsets_rad_s(predicted)
    measured = session_features(session, density, residual, offset, limits)
    simulated, nats, first_residual = [], [], residual
    for row, draw in enumerate(draws):
        own_density = RateDensity(draw.session, best.rates, noise)
        others = [other for k, other in enumerate(draws) if k != row]
        excess = _mixture_excess(own_density, draw.session, others)
        nats.append(mean_nats_per_s + excess / draw.session.duration_s)
        own_predicted = best.rates.at(draw.session)
        draw_residual = own_density.residual(own_predicted)
        offset = own_density.offsets_rad_s(own_predicted)
        simulated.append(session_features(draw.session, own_density, draw_residual, offset, limits))
        if row == 0:
            first_residual = draw_residual
    nats_per_s = log_mean_exp(by_draw) / session.duration_s
    draws_nats_per_s = np.array(nats)
    ceilings = _ceilings(session, runs, noise)
    return StageCheck(
        nats_per_s=nats_per_s,
        draws_nats_per_s=draws_nats_per_s,
        ceiling_nats_per_s=float(ceilings.mean()),
        ceiling_std_nats_per_s=float(ceilings.std(ddof=1)),
        nats_by_draw=by_draw,
        density_p_value=upper_tail(-nats_per_s, -draws_nats_per_s),
        comparisons=tuple(compare_families(measured, simulated)),
        predicted_rad_s=predicted,
        residual_rad_s=residual,
        draw_residual_rad_s=first_residual,
    )


def _mixture_excess(
    density: RateDensity, session: ObservedSession, draws: Sequence[_Draw]
) -> float:
    return log_mean_exp(np.array([density.excess(draw.rates.at(session)) for draw in draws]))


def _ceilings(session: ObservedSession, runs: Sequence[_Draw], noise: SimulatedNoise) -> FloatArray:
    """Return the log density of the pure noise of each run, nats per second.

    Runs can have other missing samples than the measurement. The excess of each run is added to the
    mean log density of the measured samples.
    """
    mean = _noise_density(session, noise).mean / session.duration_s
    excesses = [
        _noise_density(run.session, noise).excess(run.noise_rad_s.T) / run.session.duration_s
        for run in runs
    ]
    return mean + np.array(excesses)


def _noise_density(session: ObservedSession, noise: SimulatedNoise) -> ReceivedDensity:
    received = ReceivedNoise.of(noise, session.block_samples)
    return ReceivedDensity.of(received, constant_signals(session.used), noise.bias_std_rad_s)
