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
from gyrorig_solver.estimate.chain import columns_of, effect_of, shown_of, unsure_of
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.noise import NoiseModel, Periodogram, Sampling
from gyrorig_solver.estimate.normal import Normal, NormalSum, score_again
from gyrorig_solver.estimate.predict import (
    instants_per_block,
    low_pass_delay_s,
    predict_columns,
    predict_rate,
)
from gyrorig_solver.estimate.pulses import axis_motions, made_by_the_rig
from gyrorig_solver.estimate.quiet import Stretch, periodograms
from gyrorig_solver.estimate.series import PART_BLOCKS, Series, too_short
from gyrorig_solver.estimate.spikes import spikes, spread
from gyrorig_solver.estimate.start import Rough, correlation_lag, speeds
from gyrorig_solver.estimate.whitening import PartModel, WhitePart
from gyrorig_solver.model.terms.scene import Scene, Setting
from gyrorig_solver.reference.motion import ReferenceMotion

SAME_NOISE = 0.03  # of the logarithm of a weight: less does not call for new ones
LAWS = ("profile", "motor")  # what the controller does: the unit's answers follow it too
MOVING_RAD_S = 0.003  # the reference turns faster than this: moving


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


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """All of a state that a scene is made of."""

    lag_s: float
    gain: FloatArray
    bias_rad_s: FloatArray
    reference: ReferenceMotion

    def same(self, other: "_Seen") -> bool:
        """Return whether a scene of one is the other's."""
        return (
            self.reference is other.reference
            and self.lag_s == other.lag_s
            and np.array_equal(self.gain, other.gain)
            and np.array_equal(self.bias_rad_s, other.bias_rad_s)
        )


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
            raise too_short(sampling)
        self.sampling = replace(sampling, differentiated=reference.differentiated)
        self.reference = reference
        self.bias_rad_s, self.lag_s = np.zeros(3), 0.0
        self.extensions: tuple[Extension, ...] = ()
        self._stamp_std_s, self._setting = stamp_std_s, setting
        self._stretches = [_blank(s) for s in series]
        self._models: dict[tuple[int, int], PartModel] = {}
        self._scenes: dict[tuple[int, int, bool], tuple[_Seen, Scene]] = {}
        self._frozen: _Frozen | None = None

    # ---- what it is now

    @property
    def series(self) -> list[Series]:
        """The series, in the order of time."""
        return [s.series for s in self._stretches]

    @property
    def setting(self) -> Setting | None:
        """What causes beyond the base model may look at."""
        return self._setting

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
        return [np.asarray(speeds(s.rate) > MOVING_RAD_S) for s in self._stretches]

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
        other._models, other._scenes, other._frozen = {}, self._scenes.copy(), None
        return other

    def begun_at(self, other: "SessionFit") -> "SessionFit":
        """Return these samples, begun where a fit of the same recording ended.

        Args:
            other: its bias, lag, motion and spikes are taken, its samples are not.
        """
        begun = self.copy()
        begun.bias_rad_s, begun.lag_s = other.bias_rad_s, other.lag_s
        begun.reference = other.reference
        for own, there in zip(begun._stretches, other._stretches, strict=True):
            own.good = there.good.copy()
        return begun

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
        self.lag_s = max(
            (correlation_lag(s.series, s.measured, s.rate, s.used) for s in self._stretches),
            key=lambda x: x[1],
        )[0]
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
            s.used & ~spikes(s.measured - s.rate @ gain.T - self.bias_rad_s, s.used, quantum)
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
        by_own_law = getattr(self.reference, "by_own_law", None)
        if by_own_law is not None:
            laws = [one.term.link for one in self.extensions if one.free.size]
            self.reference = by_own_law(any(link in LAWS for link in laws))
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
            raise too_short(self.sampling)
        return total

    def periodograms(self, gain: FloatArray) -> tuple[list[Periodogram], str]:
        """Return the residual's power, and in words which part of the recording it is of.

        What the model of a motion lacks would pass for noise: where there are rests enough
        the frequencies that they hold are taken from them.
        """
        residuals = self.residuals(gain)
        pieces = [
            Stretch(residual, s.used, moving, s.series.parts())
            for s, residual, moving in zip(self._stretches, residuals, self.moving, strict=True)
        ]
        return periodograms(pieces, self.sampling.rate_hz)

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
            scene = self.scene(series, blocks, gain, exact=True)
            s.effect[blocks] = effect_of(self.extensions, scene)
            unsure = unsure_of(self.extensions, scene)
            if unsure is not None:
                use = use & ~np.repeat(unsure, series.block)
        if judge and use.any():
            left = measured - sampled.rate @ gain.T - self.bias_rad_s
            if self.extensions:
                left -= np.repeat(s.effect[blocks], series.block, axis=0)
            odd = spikes(left, use, self.sampling.quantum_rad_s)
            if odd.any():
                odd &= ~self._by_the_rig(series, samples, left, use, odd, gain)
            s.good[samples] = series.good[samples] & ~odd
        use = use & s.good[samples]
        s.measured[blocks] = series.means(measured, use)
        s.rate[blocks] = series.means(sampled.rate, use)
        s.used[blocks] = series.used(use)

    def _by_the_rig(
        self,
        series: Series,
        samples: slice,
        left: FloatArray,
        use: BoolArray,
        odd: BoolArray,
        gain: FloatArray,
    ) -> BoolArray:
        """Return which rows that stick out a pulse of pan or tilt explains."""
        angles = getattr(self.reference, "angles_rad", None)
        if angles is None or series.bandwidth_hz is None:
            return np.zeros_like(odd)
        time_s = series.time_s[samples] - self.lag_s
        axes = axis_motions(angles(time_s), gain)
        deviation = spread(left, use, self.sampling.quantum_rad_s)[1]
        return made_by_the_rig(left, odd, time_s, axes, series.bandwidth_hz, deviation)

    def scene(self, series: Series, blocks: slice, gain: FloatArray, exact: bool = False) -> Scene:
        """Return what causes may look at in one part of a series.

        `exact`: where a block is a sample, on the samples' own fine grid; corners of a few
        milliseconds show only there. Else on a coarse one, good for derivatives. The last
        ones of a series that is not long are kept: fit, derivatives and a search ask for them.
        """
        state = _Seen(self.lag_s, gain.copy(), self.bias_rad_s.copy(), self.reference)
        key = id(series), blocks.start, exact
        if key in self._scenes and self._scenes[key][0].same(state):
            return self._scenes[key][1]
        found = self._scene(series, blocks, gain, exact)
        if series.blocks * series.fine <= 2 * PART_BLOCKS:
            self._scenes[key] = state, found
        return found

    def _scene(self, series: Series, blocks: slice, gain: FloatArray, exact: bool) -> Scene:
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
            setting=self._setting_now(),
        )

    def _setting_now(self) -> Setting | None:
        """Return the setting with the moves as the fit has them by now."""
        courses = getattr(self.reference, "courses", None)
        if self._setting is None or courses is None or self._setting.courses is courses:
            return self._setting
        return replace(self._setting, courses=courses)

    def _model(self, k: int, blocks: slice, gain: FloatArray) -> PartModel:
        s, key = self._stretches[k], (k, blocks.start)
        if key in self._models:
            return self._models[key]
        terms, shown = np.zeros((0, blocks.stop - blocks.start, 3)), None
        if any(one.free.size for one in self.extensions):
            scene = self.scene(s.series, blocks, gain, exact=True)
            terms = columns_of(self.extensions, scene)
            shown = shown_of(self.extensions, scene)
        model = PartModel(
            rate=s.rate[blocks].copy(),
            used=s.used[blocks].copy(),
            terms=terms,
            columns=predict_columns(s.series, blocks, self.reference, self.lag_s),
            shown=shown,
        )
        # Of a long series every part is made anew when it is needed: memory before time.
        if s.series.blocks <= 2 * PART_BLOCKS:
            self._models[key] = model
        return model


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
