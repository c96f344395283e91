"""The rate-domain maximum-likelihood fit of one board against reference motions.

Rounds of Gauss-Newton over G, each recording's (b, tau) and each reference's own
unknowns; after each round the noise levels are found again in the residual's spectrum.
What recordings have in common is summed, what is a recording's own is free. All
derivatives are analytic. See `normal` for the algebra, `noise` for the density,
`session` for one recording, `observability` for what is then allowed to be a number.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.information import NAMES, Marginal, loosened, marginalise
from gyrorig_solver.estimate.noise import NoiseModel, Sampling, Spectrum, binned, fit_levels
from gyrorig_solver.estimate.normal import Normal
from gyrorig_solver.estimate.observability import Decision, decide_in, prior_std
from gyrorig_solver.estimate.session import SessionFit
from gyrorig_solver.estimate.start import shared_gain
from gyrorig_solver.estimate.whitening import OWN, whitened

ROUNDS = 12
CONVERGED_SIGMA = 1e-2  # largest last step, in standard deviations
SETTLING = 0.1  # a step that has shrunk by this is followed by one that need not be taken
UNSETTLED_SIGMA = 5.0  # a step above this judges spikes anew
FAR_SIGMA = 50.0  # a step above this takes derivatives anew
CURVED_SIGMA = 3.0  # and this, where causes take part
TURNED = -0.3  # cosine between steps of causes: less went too far
LEAST_SHARE = 0.1  # of a step
GAINS = 9
PER_SESSION = 4  # bias and time offset
TURN_X = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # d Rx(z)^T / dz


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where the fit ended: parameters, what they rest on, and each recording's state."""

    names: tuple[str, ...]  # G row by row, b, time offset, then the causes' values
    unit: FloatArray  # (p,), prior standard deviation of each
    estimate: FloatArray  # (p,); b is the last recording's, the time offset (whole lag) too
    # if that shows it, else that of the last one that does
    decision: Decision  # all else marginalised, the common shift put in
    sessions: tuple[SessionFit, ...]
    extensions: tuple[Extension, ...]
    own: tuple[Decision, ...]  # the same with each recording's own b and tau
    noises: tuple[NoiseModel, ...]  # of each recording
    spectra: tuple[Spectrum, ...]
    sources: tuple[str, ...]  # which part of each recording the noise is of
    outliers: int
    converged: bool

    @property
    def gain(self) -> FloatArray:
        """G, shape (3, 3)."""
        return self.estimate[:9].reshape(3, 3)

    def residuals(self) -> list[FloatArray]:
        """Return measured minus modelled of every series of every recording."""
        return [r for s in self.sessions for r in s.residuals(self.gain)]

    def whitened(self) -> list[FloatArray]:
        """Return the residual in units of its own deviation, white."""
        return [
            whitened([residual[part] for part in series.parts()], noise)
            for session, noise in zip(self.sessions, self.noises, strict=True)
            for series, residual in zip(session.series, session.residuals(self.gain), strict=True)
        ]

    def used(self) -> list[BoolArray]:
        """Return which blocks of every series are used."""
        return [u for s in self.sessions for u in s.used]


def solve_likelihood(
    sessions: Sequence[SessionFit], extensions: Sequence[Extension] = ()
) -> Solution:
    """Fit one board against the reference motions of its recordings.

    Args:
        sessions: in the order of time; the last one's bias and offset are the result's.
        extensions: causes beyond the base model, common to all recordings.

    Raises:
        InputError: no sample has a reference.
    """
    work = Work(sessions, extensions)
    work.begin()
    return _settled(work, ROUNDS)


def solve_again(
    before: Solution, extensions: Sequence[Extension], rounds: int = 2 * ROUNDS
) -> Solution:
    """Fit the same recordings with other causes, from where a fit ended.

    Args:
        before: is left as it is.
        extensions: all causes that are to take part, each begun near its own best.
        rounds: steps at most.
    """
    return _settled(resumed(before, extensions), rounds)


def resumed(before: Solution, extensions: Sequence[Extension]) -> "Work":
    """Return a fit under way from where another ended, which is left as it is."""
    work = Work([session.copy() for session in before.sessions], extensions)
    work.resume(before.gain, before.noises)
    return work


def _settled(work: "Work", rounds: int) -> Solution:
    """Take steps until they are small, at most so many."""
    converged = False
    before = np.inf
    for _ in range(rounds):
        step = work.round()
        if step < CONVERGED_SIGMA or (step < SETTLING and step < SETTLING * before):
            converged = True
            break
        work.look_again(step)
        before = step
    return work.solution(converged)


class Work:
    """The fit under way: `begin` or `resume`, then rounds, then `solution`."""

    def __init__(self, sessions: Sequence[SessionFit], extensions: Sequence[Extension]) -> None:
        self.sessions, self._extensions = tuple(sessions), tuple(extensions)
        self._gain = np.eye(3)
        self._noises: list[NoiseModel] = []
        self._spectra: list[Spectrum] = []
        self._sources: list[str] = []
        self._marginal: Sequence[Marginal] = ()
        self._way, self._share = np.zeros(0), 1.0  # of the causes' last step

    def begin(self) -> None:
        """Find lags by correlation, then gain and biases by plain least squares."""
        for session in self.sessions:
            session.find_lag()
        self._least_squares(first=True)
        self._least_squares(first=False)
        self._observe(judge=True, fresh=True)
        self._fit_noise()

    def resume(self, gain: FloatArray, noises: Sequence[NoiseModel]) -> None:
        """Begin where another fit of the same recordings ended."""
        self._gain, self._noises = gain.copy(), list(noises)
        self._observe(judge=True, fresh=True)
        self._fit_noise()

    def round(self) -> float:
        """Take one Gauss-Newton step; return its largest size in standard deviations."""
        found = self._marginals()
        information, score = self._joint(found)
        decision = decide_in(information, self.units())
        step = self._within(decision.inverse @ score, information, score)
        self._marginal = found
        sigma = np.sqrt(np.clip(np.diag(decision.covariance), 0.0, None))
        size = float(np.max(np.abs(step) / np.where(sigma > 0.0, sigma, np.inf)))
        self.take(step, [m.nuisance(step[self.index(k)]) for k, m in enumerate(found)])
        return size

    def take(self, step: FloatArray, motions: Sequence[FloatArray]) -> None:
        """Change all parameters, and the unknowns of each recording's reference."""
        self._gain = self._gain + step[:GAINS].reshape(3, 3)
        self._extensions = self._moved(step[step.size - self._causes :])
        for k, (session, motion) in enumerate(zip(self.sessions, motions, strict=True)):
            own = step[self.index(k)]
            session.bias_rad_s = session.bias_rad_s + own[9:12]
            session.lag_s += float(np.clip(own[12], -0.05, 0.05))
            session.reference = session.reference.moved(motion)

    def normals(self) -> list[Normal]:
        """Return each recording's normal equations, the reference's own knowledge not in."""
        return [
            session.normal(self._gain, noise)
            for session, noise in zip(self.sessions, self._noises, strict=True)
        ]

    def look_again(self, size: float) -> None:
        """Predict anew after a step of that size."""
        # A fit that still moves may have taken good samples for spikes. What causes do is
        # seldom linear: a rounded corner grows as the square of its length.
        far = CURVED_SIGMA if self._causes else FAR_SIGMA
        self._observe(judge=size > UNSETTLED_SIGMA, fresh=size > far)
        self._fit_noise()

    def _within(self, step: FloatArray, information: FloatArray, score: FloatArray) -> FloatArray:
        """Return a step that leaves causes inside their ranges, all else at its best there.

        What lies at a bound and is pushed through it stays; a step that turns back on the
        last one is halved, for it went too far.
        """
        if not self._causes:
            return step
        first = step.size - self._causes
        units = self.units()
        held = np.zeros(step.size, dtype=np.bool_)
        for _ in range(self._causes):
            before = np.concatenate([one.values[one.free] for one in self._extensions])
            moved = self._moved(step[first:])
            after = np.concatenate([one.values[one.free] for one in moved])
            stuck = (after == before) & (step[first:] != 0.0) & ~held[first:]
            if not stuck.any():
                break
            held[first:] |= stuck
            keep = np.flatnonzero(~held)
            inner = decide_in(information[np.ix_(keep, keep)], units[keep]).inverse
            step = np.zeros_like(step)
            step[keep] = inner @ score[keep]
        step[first:] = after - before
        way = step[first:] / units[first:]
        against = float(way @ self._way) if self._way.size == way.size else 0.0
        turned = against < TURNED * float(np.linalg.norm(way) * np.linalg.norm(self._way))
        self._share = max(0.5 * self._share, LEAST_SHARE) if turned else min(2.0 * self._share, 1.0)
        self._way = way
        return self._share * step

    def solution(self, converged: bool, told: FloatArray | None = None) -> Solution:
        """Return the result, each recording's common shift put into its offset.

        Args:
            converged: whether the steps have become small.
            told: information about all its parameters, where others took part in the fit.
        """
        causes = [one.values[one.free] for one in self._extensions]
        whole = self._joint(self._marginal)[0] if told is None else told
        for k, session in enumerate(self.sessions):
            whole = loosened(whole, int(self.index(k)[12]), session.common_std_s)
        own = [self._of_one(whole, k) for k in range(len(self.sessions))]
        unit = np.concatenate([prior_std(NAMES), *(one.prior_std for one in self._extensions)])
        decisions = tuple(self._zero_open(decide_in(one, unit)) for one in own)
        # A board that lay still last tells its bias, but not how late its samples are.
        last = len(own) - 1
        moved = max((k for k, one in enumerate(decisions) if one.shows(12)), default=last)
        joint = decisions[last]
        if moved != last:
            joint = self._zero_open(decide_in(self._of_one(whole, last, moved), unit))
        return Solution(
            names=(*NAMES, *(name for one in self._extensions for name in one.names)),
            unit=unit,
            estimate=np.concatenate(
                [
                    self._gain.ravel(),
                    self.sessions[last].bias_rad_s,
                    [self.sessions[moved].time_offset_s],
                    *causes,
                ]
            ),
            decision=joint,
            sessions=self.sessions,
            extensions=self._extensions,
            own=decisions,
            noises=tuple(self._noises),
            spectra=tuple(self._spectra),
            sources=tuple(self._sources),
            outliers=sum(session.outliers for session in self.sessions),
            converged=converged,
        )

    def _zero_open(self, decision: Decision) -> Decision:
        """Return it with what the causes leave open of the tilt's zero in G's deviations.

        A stage that stands z higher than told turns by Rx(z)^T omega: see `tilt_zero`.
        """
        each = [one.term.tilt_zero_std_rad(one.values) for one in self._extensions]
        std = float(np.linalg.norm(each))
        if std == 0.0:
            return decision
        moved = np.zeros(decision.covariance.shape[0])
        moved[:GAINS] = std * (self._gain @ TURN_X).ravel()
        return replace(decision, covariance=decision.covariance + np.outer(moved, moved))

    @property
    def _causes(self) -> int:
        """How many values of causes are fitted."""
        return sum(one.free.size for one in self._extensions)

    def units(self) -> FloatArray:
        """Return the prior deviation of all parameters: G, each (b, tau), the causes' values."""
        own = prior_std(NAMES)
        each = [own[GAINS:]] * len(self.sessions)
        return np.concatenate([own[:GAINS], *each, *(one.prior_std for one in self._extensions)])

    def index(self, k: int, offset_of: int | None = None) -> IntArray:
        """Return where the parameters of recording `k` are among all: G, b, tau, causes.

        `offset_of`: take the time offset of that recording.
        """
        first = GAINS + PER_SESSION * k
        after = GAINS + PER_SESSION * len(self.sessions)
        offset = GAINS + PER_SESSION * (k if offset_of is None else offset_of) + 3
        own = (*range(GAINS), *range(first, first + 3), offset)
        return np.array([*own, *range(after, after + self._causes)], dtype=np.int64)

    def _moved(self, step: FloatArray) -> tuple[Extension, ...]:
        """Return the causes with their values changed."""
        found, first = [], 0
        for one in self._extensions:
            found.append(one.moved(step[first : first + one.free.size]))
            first += one.free.size
        return tuple(found)

    def _marginals(self) -> list[Marginal]:
        return [
            marginalise(normal, session.reference, OWN + self._causes)
            for session, normal in zip(self.sessions, self.normals(), strict=True)
        ]

    def _joint(self, found: Sequence[Marginal]) -> tuple[FloatArray, FloatArray]:
        """Return the sum of all recordings' evidence, each with its own bias and offset."""
        size = GAINS + PER_SESSION * len(found) + self._causes
        information, score = np.zeros((size, size)), np.zeros(size)
        for k, marginal in enumerate(found):
            index = self.index(k)
            information[np.ix_(index, index)] += marginal.information
            score[index] += marginal.score
        first = GAINS + PER_SESSION * len(found)
        for one in self._extensions:
            if one.told is not None:
                at = slice(first, first + one.free.size)
                information[at, at] += one.told.information
                score[at] += one.told.pull(one.values[one.free])
            first += one.free.size
        return information, score

    def _of_one(self, whole: FloatArray, k: int, offset_of: int | None = None) -> FloatArray:
        """Return the information of G and recording `k`'s own, the others' taken out."""
        keep = self.index(k, offset_of)
        drop = np.setdiff1d(np.arange(whole.shape[0]), keep)
        if not drop.size:
            return whole
        # A hair of prior: a recording at rest does not know its offset.
        unit = self.units()[drop]
        inner = whole[np.ix_(drop, drop)] + np.diag(1e-6 / unit**2)
        across = whole[np.ix_(keep, drop)]
        left = whole[np.ix_(keep, keep)] - across @ np.linalg.solve(inner, across.T)
        return np.asarray(left, dtype=np.float64)

    def _least_squares(self, first: bool) -> None:
        sums = [s.rough(s.used if first else s.ordinary(self._gain)) for s in self.sessions]
        self._gain = shared_gain(sums)
        for session, rough in zip(self.sessions, sums, strict=True):
            session.bias_rad_s = rough.bias(self._gain)

    def _observe(self, judge: bool, fresh: bool) -> None:
        for session in self.sessions:
            session.extensions = self._extensions
            session.observe(self._gain, judge, fresh)

    def _fit_noise(self) -> None:
        found = [session.periodograms(self._gain) for session in self.sessions]
        self._spectra = [binned(pieces) for pieces, _ in found]
        self._sources = [said for _, said in found]
        before: list[FloatArray | None] = [noise.levels for noise in self._noises]
        before = before or [None] * len(self.sessions)
        self._noises = [
            fit_levels(spectrum, self._sampling(session), levels)
            for spectrum, session, levels in zip(self._spectra, self.sessions, before, strict=True)
        ]

    def _sampling(self, session: SessionFit) -> Sampling:
        """Return how a recording was sampled: the noise passes the sensor's true low-pass."""
        sampling = session.sampling
        share = math.prod(one.term.bandwidth_share(one.values) for one in self._extensions)
        if sampling.bandwidth_hz is None or share == 1.0:
            return sampling
        return replace(sampling, bandwidth_hz=sampling.bandwidth_hz * share)
