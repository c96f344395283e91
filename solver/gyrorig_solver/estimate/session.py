"""One recording of a board under way: its samples, its reference, its own bias and lag.

What several recordings of a board have in common (gain, terms) is held by `likelihood`;
everything that belongs to one of them is here, so that recordings are worked through one
after the other and only sums meet.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.estimate.extension import Extension, columns_of, effect_of
from gyrorig_solver.estimate.noise import NoiseModel, Periodogram, Sampling
from gyrorig_solver.estimate.normal import Normal, NormalSum, score_again
from gyrorig_solver.estimate.predict import (
    instants_per_block,
    low_pass_delay_s,
    predict_columns,
    predict_rate,
)
from gyrorig_solver.estimate.series import PART_BLOCKS, Series, quick_length
from gyrorig_solver.estimate.whitening import PartModel, WhitePart
from gyrorig_solver.model.terms.scene import Scene, Setting
from gyrorig_solver.reference.motion import ReferenceMotion

SPIKE_SIGMA = 6.0  # a sample this far off is no sample of the model's noise
SHORTEST_SPECTRUM = 256  # blocks
REST_S, ENOUGH_REST_S = 4.0, 20.0  # a rest worth a spectrum, and how much of such rest is enough
LEAST_WAVES = 2.0  # of the slowest frequency taken from a rest
SETTLE_S = 0.3  # after a move
SAME_NOISE = 0.03  # of the logarithm of a weight: less does not call for new ones
ENOUGH = 8192  # samples to judge a deviation by
NEIGHBOURS = 4  # on each side: a glitch of up to four samples sticks out from nine
GROSS = 8.0  # times the limit: 48 deviations
FEWEST_CALM = 3
SEARCH_S = 0.3  # the lag is looked for within this range first
WEAK = 1e-4  # weight of the nominal gain in a start, (rad/s)^2 times samples
CORRELATED = 1 << 17  # blocks: minutes tell the lag as well as hours
MOVING_RAD_S = 0.003  # the reference turns faster than this: moving


@dataclass(frozen=True, slots=True, eq=False)
class Rough:
    """Sums of plain least squares over one recording: (rate, 1) against measured."""

    gram: FloatArray  # (4, 4)
    moment: FloatArray  # (4, 3)
    square: float  # sum of what was measured, squared

    def centred(self) -> "Rough":
        """Return the same with the recording's own bias taken out, (3, 3) each."""
        count = max(float(self.gram[3, 3]), 1.0)
        mean, measured = self.gram[3, :3] / count, self.moment[3] / count
        return Rough(
            self.gram[:3, :3] - count * np.outer(mean, mean),
            self.moment[:3] - count * np.outer(mean, measured),
            self.square - count * float(measured @ measured),
        )

    def bias(self, gain: FloatArray) -> FloatArray:
        """Return the bias that goes with a gain, shape (3,)."""
        count = max(float(self.gram[3, 3]), 1.0)
        return np.asarray((self.moment[3] - gain @ self.gram[3, :3]) / count, dtype=np.float64)

    def misfit(self, gain: FloatArray, bias_rad_s: FloatArray) -> float:
        """Return the sum of squared residuals of all axes."""
        both = np.column_stack([gain, bias_rad_s])
        cross = 2.0 * float(np.sum(both * self.moment.T))
        return self.square - cross + float(np.sum((both @ self.gram) * both))


@dataclass(slots=True, eq=False)
class _Stretch:
    """The state of one series; block means."""

    series: Series
    good: BoolArray  # (samples,), without spikes
    measured: FloatArray  # (n, 3)
    rate: FloatArray  # (n, 3), stage
    used: BoolArray  # (n,)
    effect: FloatArray  # (n, 3), of the causes beyond the base model, sensor frame


@dataclass(frozen=True, slots=True, eq=False)
class _Frozen:
    """A recording's normal equations as they were, for rounds that change little."""

    part: WhitePart
    normal: Normal
    noise: NoiseModel

    def holds(self, noise: NoiseModel) -> bool:
        """Return whether weights at another noise are the same, to a few hundredths."""
        n = self.part.deviation.shape[0]
        ratio = noise.variance(n)[1:] / self.part.deviation[1:] ** 2
        return bool(np.all(np.abs(np.log(ratio)) < SAME_NOISE))

    def again(self, residual: FloatArray, local: int) -> Normal:
        """Return them at another residual, shape (n, 3)."""
        return Normal(self.normal.matrix, score_again(self.part, residual, local))


class SessionFit:
    """A recording's state: what `likelihood` asks of it in every round."""

    def __init__(
        self,
        series: Sequence[Series],
        sampling: Sampling,
        reference: ReferenceMotion,
        stamp_std_s: float = 0.0,
        setting: Setting | None = None,
    ) -> None:
        """Begin with nothing known.

        Args:
            series: of one board and recording, from `build_series`.
            sampling: how they were sampled.
            reference: the stage's motion on the same time axis.
            stamp_std_s: what is not known of the samples' own times, one shift of all.
            setting: what causes beyond the base model may look at.

        Raises:
            InputError: there is no series.
        """
        if not series:
            raise InputError("no stretch of samples is long enough", "record for longer")
        self.sampling = replace(sampling, differentiated=reference.differentiated)
        self.reference = reference
        self.bias_rad_s, self.lag_s = np.zeros(3), 0.0
        self.extensions: tuple[Extension, ...] = ()
        self._stamp_std_s, self._setting = stamp_std_s, setting
        self._stretches = [_blank(s) for s in series]
        self._models: dict[tuple[int, int], PartModel] = {}
        self._frozen: _Frozen | None = None

    # ---- what it is now

    @property
    def series(self) -> list[Series]:
        """The series, in the order of time."""
        return [s.series for s in self._stretches]

    @property
    def common_std_s(self) -> float:
        """One shift in time of this recording that nothing in it can show."""
        return float(np.hypot(self.reference.common_std_s, self._stamp_std_s))

    @property
    def time_offset_s(self) -> float:
        """The whole lag, the low-pass' own delay put in."""
        return self.lag_s + low_pass_delay_s(self._stretches[0].series)

    @property
    def measured(self) -> list[FloatArray]:
        """Block means as measured, (n, 3) for each series."""
        return [s.measured for s in self._stretches]

    @property
    def effects(self) -> list[FloatArray]:
        """What causes beyond the base model add, sensor frame, (n, 3) for each series."""
        return [s.effect for s in self._stretches]

    @property
    def rates(self) -> list[FloatArray]:
        """Stage rates, (n, 3) for each series."""
        return [s.rate for s in self._stretches]

    @property
    def used(self) -> list[BoolArray]:
        """Which blocks are used, (n,) for each series."""
        return [s.used for s in self._stretches]

    @property
    def moving(self) -> list[BoolArray]:
        """Which blocks are in motion, (n,) for each series."""
        return [np.asarray(_speed(s.rate) > MOVING_RAD_S) for s in self._stretches]

    @property
    def outliers(self) -> int:
        """How many samples were set aside as spikes."""
        return sum(int(np.sum(s.series.good & ~s.good)) for s in self._stretches)

    def residuals(self, gain: FloatArray) -> list[FloatArray]:
        """Return measured minus modelled, zero where unused, (n, 3) for each series.

        Args:
            gain: G, shape (3, 3).
        """
        found = []
        for s in self._stretches:
            left = s.measured - s.rate @ gain.T - self.bias_rad_s
            if self.extensions:
                left -= s.effect
            found.append(left if s.used.all() else np.where(s.used[:, None], left, 0.0))
        return found

    def copy(self) -> "SessionFit":
        """Return the same state, to be fitted on without changing this one."""
        other = copy(self)
        other._stretches = [
            replace(
                s,
                good=s.good.copy(),
                measured=s.measured.copy(),
                rate=s.rate.copy(),
                used=s.used.copy(),
                effect=s.effect.copy(),
            )
            for s in self._stretches
        ]
        other._models, other._frozen = {}, None
        return other

    def derivatives(self, gain: FloatArray) -> Iterator[tuple[int, slice, PartModel, Scene, Scene]]:
        """Yield each part's series, blocks, derivatives, and its scene coarse and exact.

        Args:
            gain: G, shape (3, 3).
        """
        for k, s in enumerate(self._stretches):
            for blocks in s.series.parts():
                model = self._model(k, blocks, gain)
                coarse = self.scene(s.series, blocks, gain)
                exact = self.scene(s.series, blocks, gain, exact=True)
                yield k, blocks, model, coarse, exact

    # ---- what a fit does with it

    def find_lag(self) -> None:
        """Look for the lag at which measured and reference speeds agree best."""
        self._look(0.0)
        self.lag_s = max((_correlation_lag(s) for s in self._stretches), key=lambda x: x[1])[0]
        self._look(self.lag_s)
        if not any(s.used.any() for s in self._stretches):
            raise InputError(
                "no sample lies where the reference motion is known",
                "check that unit and board were recorded together",
            )

    def ordinary(self, gain: FloatArray) -> list[BoolArray]:
        """Return which used blocks a gain explains, as far as a spike lets them be judged."""
        quantum = self.sampling.quantum_rad_s
        return [
            s.used & ~_odd(s.measured - s.rate @ gain.T - self.bias_rad_s, s.used, quantum)
            for s in self._stretches
        ]

    def rough(self, use: Sequence[BoolArray]) -> Rough:
        """Return the sums of plain least squares over some blocks of each series."""
        gram, moment, square = np.zeros((4, 4)), np.zeros((4, 3)), 0.0
        for s, some in zip(self._stretches, use, strict=True):
            design = np.column_stack([s.rate, np.ones(some.size)])[some]
            gram += design.T @ design
            measured = s.measured[some]
            moment += design.T @ measured
            square += float(np.sum(measured**2))
        return Rough(gram, moment, square)

    def observe(self, gain: FloatArray, judge: bool, fresh: bool) -> None:
        """Predict anew at the present lag and reference.

        Args:
            gain: G, shape (3, 3), to judge spikes by.
            judge: set spikes aside anew.
            fresh: take derivatives anew too.
        """
        before = [s.used.copy() for s in self._stretches]
        for s in self._stretches:
            for blocks in s.series.parts():
                self._observe(s, blocks, gain, judge)
        same = all(np.array_equal(s.used, b) for s, b in zip(self._stretches, before, strict=True))
        if fresh or not same:
            self._frozen = None
            self._models.clear()

    def normal(self, gain: FloatArray, noise: NoiseModel) -> Normal:
        """Return the normal equations of everything that this recording knows."""
        local, _ = self.reference.information.size
        residuals = self.residuals(gain)
        if self._frozen is not None and self._frozen.holds(noise):
            return self._frozen.again(residuals[0], local)
        total: Normal | None = None
        for k, (s, residual) in enumerate(zip(self._stretches, residuals, strict=True)):
            parts = s.series.parts()
            sums: NormalSum | None = None
            for blocks in parts:
                part = WhitePart.of(self._model(k, blocks, gain), gain, noise)
                sums = sums or NormalSum(noise, local, part.size)
                sums.add(part, residual[blocks], whole=len(parts) == 1)
            if sums is not None:
                total = sums.total() if total is None else total + sums.total()
            if len(residuals) == len(parts) == 1 and total is not None:
                self._frozen = _Frozen(part, total, noise)
        if total is None:
            raise InputError("no stretch of samples is long enough", "record for longer")
        return total

    def periodograms(self, gain: FloatArray) -> tuple[list[Periodogram], str]:
        """Return the residual's power, and in words which part of the recording it is of.

        What the model of a motion lacks would pass for noise: where there are rests enough
        the frequencies that they hold are taken from them.
        """
        rate_hz = self.sampling.rate_hz
        residuals, moving = self.residuals(gain), self.moving
        whole = [
            Periodogram.of(residual[blocks], rate_hz, float(np.mean(s.used)))
            for s, residual in zip(self._stretches, residuals, strict=True)
            for blocks in s.series.parts()
        ]
        shortest = max(SHORTEST_SPECTRUM, round(REST_S * rate_hz))
        rests = [
            residual[run]
            for s, residual, turning in zip(self._stretches, residuals, moving, strict=True)
            for run in _runs(s.used & ~_widened(turning, round(SETTLE_S * rate_hz)), shortest)
        ]
        rest_s = sum(rest.shape[0] for rest in rests) / rate_hz
        if rest_s < ENOUGH_REST_S or not any(turning.any() for turning in moving):
            return whole, "spectrum of the residual, whole recording"
        split_hz = LEAST_WAVES * rate_hz / shortest
        still = [Periodogram.of(rest, rate_hz).between(split_hz, np.inf) for rest in rests]
        slow = [piece.between(0.0, split_hz) for piece in whole]
        said = f"spectrum: {rest_s:.0f} s of rests above {split_hz:.1f} Hz, whole recording below"
        return [*slow, *still], said

    # ---- how

    def _look(self, lag_s: float) -> None:
        """Predict block means coarsely: the low-pass as its delay."""
        for s in self._stretches:
            delay_s = low_pass_delay_s(s.series)
            for blocks in s.series.parts():
                edges = s.series.block_edges_s(blocks, 1) - lag_s - delay_s
                rate = self.reference.evaluate(edges, derivatives=False).rate_rad_s
                known: BoolArray = np.asarray(np.isfinite(rate).all(axis=1), dtype=np.bool_)
                samples = s.series.samples_of(blocks)
                use = s.series.good[samples] & np.repeat(known, s.series.block)
                s.rate[blocks] = np.where(known[:, None], rate, 0.0)
                s.measured[blocks] = s.series.means(s.series.rate_rad_s(samples), use)
                s.used[blocks] = s.series.used(use)

    def _observe(self, s: _Stretch, blocks: slice, gain: FloatArray, judge: bool) -> None:
        series = s.series
        samples = series.samples_of(blocks)
        sampled = predict_rate(series, blocks, self.reference, self.lag_s)
        measured = series.rate_rad_s(samples)
        use = series.good[samples] & sampled.known
        if self.extensions:
            s.effect[blocks] = effect_of(
                self.extensions, self.scene(series, blocks, gain, exact=True)
            )
        if judge and use.any():
            left = measured - sampled.rate @ gain.T - self.bias_rad_s
            if self.extensions:
                left -= np.repeat(s.effect[blocks], series.block, axis=0)
            s.good[samples] = series.good[samples] & ~_odd(left, use, self.sampling.quantum_rad_s)
        use = use & s.good[samples]
        s.measured[blocks] = series.means(measured, use)
        s.rate[blocks] = series.means(sampled.rate, use)
        s.used[blocks] = series.used(use)

    def scene(self, series: Series, blocks: slice, gain: FloatArray, exact: bool = False) -> Scene:
        """Return what causes may look at in one part of a series.

        `exact`: where a block is a sample, on the samples' own fine grid; corners of a few
        milliseconds show only there. Else on a coarse one, good for derivatives.
        """
        per, fine = instants_per_block(series), 1
        if exact and series.block == 1:
            fine = series.fine
        edges = series.block_edges_s(blocks, per * fine) - self.lag_s
        angles = getattr(self.reference, "angles_rad", None)
        return Scene.build(
            edges,
            None if angles is None else angles(edges),
            np.ones((blocks.stop - blocks.start) * per, dtype=np.bool_),
            block=per,
            fine=fine,
            bandwidth_hz=series.bandwidth_hz,
            gain=gain,
            bias_rad_s=self.bias_rad_s,
            rate_rad_s=self.reference.evaluate(edges, derivatives=False).rate_rad_s,
            setting=self._setting,
        )

    def _model(self, k: int, blocks: slice, gain: FloatArray) -> PartModel:
        s, key = self._stretches[k], (k, blocks.start)
        if key in self._models:
            return self._models[key]
        terms = np.zeros((0, blocks.stop - blocks.start, 3))
        if any(one.free.size for one in self.extensions):
            terms = columns_of(self.extensions, self.scene(s.series, blocks, gain, exact=True))
        model = PartModel(
            rate=s.rate[blocks].copy(),
            used=s.used[blocks].copy(),
            terms=terms,
            columns=predict_columns(s.series, blocks, self.reference, self.lag_s),
        )
        # Of a long series every part is made anew when it is needed: memory before time.
        if s.series.blocks <= 2 * PART_BLOCKS:
            self._models[key] = model
        return model


def shared_gain(sums: Sequence[Rough]) -> FloatArray:
    """Return the gain that fits recordings best, each with its own bias, shape (3, 3).

    What nothing excites stays nominal.
    """
    gram = np.eye(3) * WEAK
    moment = gram.copy()
    for one in (rough.centred() for rough in sums):
        gram += one.gram
        moment += one.moment
    return np.asarray(np.linalg.solve(gram, moment).T, dtype=np.float64)


def _blank(series: Series) -> _Stretch:
    n = series.blocks
    none = np.zeros((n, 3))
    return _Stretch(
        series=series,
        good=series.good.copy(),
        measured=none,
        rate=none.copy(),
        used=np.zeros(n, np.bool_),
        effect=none.copy(),
    )


def _runs(use: BoolArray, shortest: int) -> list[slice]:
    """Return where `use` holds for at least `shortest` rows; long runs in parts."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], use.astype(np.int8), [0]])))
    found = []
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        for first in range(begin, end, PART_BLOCKS):
            last = min(end, first + PART_BLOCKS)
            if last - first >= shortest:
                found.append(slice(first, first + quick_length(last - first)))
    return found


def _widened(moving: BoolArray, after: int) -> BoolArray:
    """Return the same, each stretch lasting `after` rows longer."""
    late = np.convolve(moving, np.ones(after + 1))[: moving.size]
    return np.asarray(late > 0.5, dtype=np.bool_)


def _speed(rate: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", rate, rate)), dtype=np.float64)


def _odd(left: FloatArray, use: BoolArray, quantum_rad_s: float) -> BoolArray:
    """Return which rows are spikes: far from all, and far from their neighbours.

    What a wrong start or a wrong model leaves is smooth over some samples: it is no spike,
    and to set it aside would hide it.
    """
    own = (left if use.all() else left[use])[:: max(1, int(use.sum()) // ENOUGH)]
    middle = np.median(own, axis=0)
    deviation = 1.4826 * np.median(np.abs(own - middle), axis=0)
    limit = SPIKE_SIGMA * np.maximum(deviation, quantum_rad_s)
    odd = np.asarray((np.abs(left - middle) > limit).any(axis=1) & use, dtype=np.bool_)
    if not odd.any():
        return odd
    far = np.flatnonzero(odd)
    # At the ends the window is moved inwards, so that it holds as many.
    begin = np.clip(far - NEIGHBOURS, 0, max(0, left.shape[0] - 2 * NEIGHBOURS - 1))
    near = np.minimum(begin[:, None] + np.arange(2 * NEIGHBOURS + 1), left.shape[0] - 1)
    fit = use[near]
    # Judged by all neighbours, so that a transient of the rig stays; what is beyond any
    # transient by those that are not far themselves: glitches may come in twos.
    gross = (np.abs(left[far] - middle) > GROSS * limit).any(axis=1)
    calm = fit & ~odd[near]
    enough = calm.sum(axis=1) >= FEWEST_CALM
    by = np.where((gross & enough)[:, None], calm, fit)
    around = np.where(by[:, :, None], left[near], np.nan)
    alone = np.abs(left[far] - np.nanmedian(around, axis=1)) > limit
    odd[far] = alone.any(axis=1)
    return odd


def _correlation_lag(s: _Stretch) -> tuple[float, float]:
    """Return the lag at which measured and reference speeds agree best, and how well.

    Speeds (norms) do not care how the sensor is mounted. The mean is taken out of both.
    """
    first = slice(0, CORRELATED)
    use, rate = s.used[first], s.rate[first]
    if use.sum() < 10:
        return 0.0, -1.0
    turning = np.where(use, _speed(rate), 0.0)
    if np.std(turning[use]) < MOVING_RAD_S:
        return 0.0, -1.0
    bias = np.median(s.measured[first][use], axis=0)
    measured = np.where(use, _speed(s.measured[first] - bias), 0.0)
    measured = np.where(use, measured - measured[use].mean(), 0.0)
    turning = np.where(use, turning - turning[use].mean(), 0.0)
    size = 1 << (2 * measured.size - 1).bit_length()
    product = np.fft.irfft(np.fft.rfft(measured, size) * np.conj(np.fft.rfft(turning, size)), size)
    period_s = s.series.period_s * s.series.block
    reach = int(SEARCH_S / period_s)
    lags = np.arange(-reach, reach + 1)
    score = product[lags]
    best = int(np.argmax(score))
    quality = float(score[best] / (np.linalg.norm(measured) * np.linalg.norm(turning) + 1e-30))
    return (float(lags[best]) + _vertex(score[best - 1 : best + 2])) * period_s, quality


def _vertex(three: FloatArray) -> float:
    """Return where the parabola through three neighbours is highest, from the middle one."""
    if three.size < 3:
        return 0.0
    bend = three[0] - 2.0 * three[1] + three[2]
    return float(0.5 * (three[0] - three[2]) / bend) if bend < 0.0 else 0.0
