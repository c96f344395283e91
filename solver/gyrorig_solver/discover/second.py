"""A model that was fitted to some recordings, on another one of the same board.

Gain and causes stay as they were fitted; bias, time offset and the motion's own unknowns
are the other recording's own and are fitted to it. What happened once stays where it
happened: causes of scope `recording` are left out. How well the model then predicts is
the log likelihood of the residual at the best of those, the noise levels found in it.

What to use when: `Other.of` once for a recording; `judged` for each model on it, those
that are to be compared with the same noise. `gain.held_out_by` does both for two fits.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.information import marginalise
from gyrorig_solver.estimate.likelihood import (
    CONVERGED_SIGMA,
    FAR_SIGMA,
    GAINS,
    ROUNDS,
    UNSETTLED_SIGMA,
    Solution,
)
from gyrorig_solver.estimate.noise import NoiseModel, binned, fit_levels
from gyrorig_solver.estimate.observability import PRIOR_STD
from gyrorig_solver.estimate.session import SessionFit
from gyrorig_solver.estimate.whitening import OWN, whitened
from gyrorig_solver.on_unit import unit_session
from gyrorig_solver.samples import GyroSamples

MOST_LAG_S = 0.05  # of one step


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """One model on a recording that it was not fitted to."""

    session: SessionFit  # at the best bias, offset and motion
    gain: FloatArray  # (3, 3)
    noise: NoiseModel
    log_likelihood: float  # nats, up to what all models at the same noise have in common
    left_out: tuple[Extension, ...]  # causes that this recording does not have, or not show

    @property
    def white(self) -> list[FloatArray]:
        """Whitened residual of each series, (n, 3)."""
        return _white(self.session, self.gain, self.noise)


@dataclass(frozen=True, slots=True, eq=False)
class Other:
    """A recording that nothing was fitted to."""

    session: SessionFit
    name: str

    @classmethod
    def of(
        cls,
        recording: Recording,
        board: str,
        fitted: Solution,
        samples: GyroSamples | None = None,
    ) -> "Other":
        """Return a recording, ready for models of the same board.

        Args:
            recording: of a unit.
            board: in it.
            fitted: one of the models: its temperatures count from a mean.
            samples: taken instead of the recording's own, say with a known effect taken
                off them.

        Raises:
            InputError: the board is not there, or too few samples are.
            UsageError: the recording is none of a unit.
        """
        known = fitted.sessions[0].setting
        temperature = None if known is None else known.temperature
        mean = None if temperature is None else temperature.mean_degc
        return cls(unit_session(recording, board, mean, samples), recording.path.name)

    def judged(self, model: Solution, like: Judged | None = None) -> Judged:
        """Return how well a fitted model predicts this recording.

        Args:
            model: its gain and causes are taken.
            like: another model on it, whose noise levels and samples in use are taken.
        """
        kept, left_out = self._there(model)
        if like is None:
            session = self.session.copy()
            session.extensions = kept
            session.find_lag()
            rough = session.rough(session.ordinary(model.gain))
            session.bias_rad_s = rough.bias(model.gain)
        else:
            session = self.session.begun_at(like.session)
            session.extensions = kept
        noise = _followed(session, model.gain, None if like is None else like.noise)
        cost = 0.5 * sum(float(np.sum(w**2)) for w in _white(session, model.gain, noise))
        pull = session.reference.pull
        cost += 0.5 * float(pull @ session.reference.information.times(pull))
        return Judged(session, model.gain, noise, -cost, left_out)

    def _there(self, model: Solution) -> tuple[tuple[Extension, ...], tuple[Extension, ...]]:
        """Return the causes that are the same here, held as they are, and the others."""
        series = self.session.series[0]
        scene = self.session.scene(series, series.parts()[0], model.gain)
        kept: list[Extension] = []
        left_out: list[Extension] = []
        for one in model.extensions:
            persists = one.term.kind == "known" or one.term.scope != "recording"
            if persists and one.term.missing(scene) is None:
                kept.append(replace(one, free=_none(), told=None))
            else:
                left_out.append(one)
        return tuple(kept), tuple(left_out)


def _none() -> IntArray:
    return np.zeros(0, dtype=np.int64)


def _followed(session: SessionFit, gain: FloatArray, noise: NoiseModel | None) -> NoiseModel:
    """Fit bias, offset and motion to a model that is held; return the noise, found or given."""
    free = slice(GAINS, OWN)
    prior = np.array([PRIOR_STD["bias"]] * 3 + [PRIOR_STD["time_offset"]]) ** -2.0
    own_noise = noise is None
    session.observe(gain, judge=own_noise, fresh=True)
    levels = noise or _noise(session, gain, None)
    for _ in range(ROUNDS):
        marginal = marginalise(session.normal(gain, levels), session.reference)
        information = marginal.information[free, free] + np.diag(prior)
        step = np.zeros(OWN)
        step[free] = np.linalg.solve(information, marginal.score[free])
        session.bias_rad_s = session.bias_rad_s + step[GAINS : GAINS + 3]
        session.lag_s += float(np.clip(step[OWN - 1], -MOST_LAG_S, MOST_LAG_S))
        session.reference = session.reference.moved(marginal.nuisance(step))
        sigma = np.sqrt(np.diag(np.linalg.inv(information)))
        size = float(np.max(np.abs(step[free]) / sigma))
        session.observe(gain, judge=own_noise and size > UNSETTLED_SIGMA, fresh=size > FAR_SIGMA)
        if own_noise:
            levels = _noise(session, gain, levels)
        if size < CONVERGED_SIGMA:
            break
    return levels


def _noise(session: SessionFit, gain: FloatArray, before: NoiseModel | None) -> NoiseModel:
    pieces, _ = session.periodograms(gain)
    return fit_levels(binned(pieces), session.sampling, None if before is None else before.levels)


def _white(session: SessionFit, gain: FloatArray, noise: NoiseModel) -> list[FloatArray]:
    residuals: Sequence[FloatArray] = session.residuals(gain)
    return [
        whitened([residual[part] for part in series.parts()], noise)
        for series, residual in zip(session.series, residuals, strict=True)
    ]
