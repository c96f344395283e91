"""What a fit against reference attitudes cannot take of a signal.

The same space as beside a unit's motion (see `projection`), so that a search asks it the same
questions, but for three things. The reference is the noisy side: its density is found in the
residual, a smooth model times what the bins say beside it. Only the fit's band takes part, and
a series is as long as that band has coefficients. And a camera's noise grows with the motion:
each moment weighs by how much the residual scatters about it.

What to use when: `AttitudeSpace.beside` a settled fit. Its scenes turn as the gyro itself says,
its own gain and bias taken out: what is there in the gyro's noise is nothing beside the
reference's, and functions of a noisy rate would be functions of that noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.fft import dct, idct
from scipy.sparse import csc_array, csr_array

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.estimate.attitude import Settled
from gyrorig_solver.estimate.attitude_rounds import level_by_bins
from gyrorig_solver.estimate.chain import columns_of, effect_of
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.followed import Prior
from gyrorig_solver.estimate.likelihood import GAINS, PER_SESSION
from gyrorig_solver.estimate.noise import NoiseModel, Periodogram, Sampling, binned, fit_levels
from gyrorig_solver.estimate.observability import PRIOR_STD
from gyrorig_solver.estimate.projection import Projection, Signal
from gyrorig_solver.estimate.stretch import Stretch
from gyrorig_solver.model.terms.scene import Scene, Setting

FINE_S = 0.01  # steps that functions of the rates are taken at: hands are slower
FINER = 8.0  # a block's rate is so many times the band
SHORTEST_S = 2.0  # stretches: less holds next to nothing of the band
LOCAL_S, LOCAL_VALUES = 5.0, 40  # over which a moment's scatter is judged, at least
LEAST_SCATTER = 0.3  # times the usual: a moment of luck is not a good one
CHUNK_S = 5.0  # longer than a residual's correlation
MOVING_RAD_S = 0.05  # a board faster than this is in motion


@dataclass(frozen=True, eq=False)
class AttitudeScene(Scene):
    """A scene whose specific force the board's own accelerometer has measured."""

    force_m_s2: FloatArray | None = None  # (n, 3), stage frame

    @cached_property
    def specific_force_m_s2(self) -> FloatArray:
        """What the accelerometer reads, zeros where there is none, shape (n, 3)."""
        return np.zeros((self.n, 3)) if self.force_m_s2 is None else self.force_m_s2


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """One stretch as block means, beside its scene."""

    recording: int
    scene: AttitudeScene
    measured: FloatArray  # (blocks, 3), the gyro
    modelled: FloatArray  # (blocks, 3), G w + b of the fit
    rate: FloatArray  # (blocks, 3), of the stage, as the gyro says
    slope: FloatArray  # (blocks, 3), of the gyro by the lag
    time_s: FloatArray  # (blocks,)
    kept: int  # coefficients in the band

    @property
    def blocks(self) -> int:
        """How many block means."""
        return int(self.measured.shape[0])

    @property
    def residual(self) -> FloatArray:
        """What the base model leaves, glitches of the reference cut, (blocks, 3)."""
        return self.measured - self.modelled


@dataclass(frozen=True, slots=True, eq=False)
class Whitener:
    """What makes one stretch's noise white and even."""

    deviation: FloatArray  # (kept, 3), of each coefficient
    scatter: FloatArray  # (kept,), of each moment, about 1

    def white(self, signals: FloatArray) -> FloatArray:
        """Return signals (k, blocks, 3) in units of the noise, (k, 3 kept)."""
        spectrum = dct(signals.transpose(0, 2, 1), axis=-1, norm="ortho")
        some = spectrum[:, :, : self.deviation.shape[0]] / self.deviation.T
        even = idct(some, axis=-1, norm="ortho") / self.scatter
        return np.asarray(even.reshape(signals.shape[0], -1), dtype=np.float64)

    def rate(self, white: FloatArray, blocks: int) -> FloatArray:
        """Return the rates, (blocks, 3), of a whitened signal (3 kept,): its band."""
        even = white.reshape(3, -1) * self.scatter
        return self._padded(dct(even, axis=-1, norm="ortho") * self.deviation.T, blocks)

    def weighed(self, white: FloatArray, blocks: int) -> FloatArray:
        """Return the rates whose product with a signal is the whitened product."""
        even = white.reshape(3, -1) / self.scatter
        return self._padded(dct(even, axis=-1, norm="ortho") / self.deviation.T, blocks)

    def _padded(self, spectrum: FloatArray, blocks: int) -> FloatArray:
        whole = np.zeros((3, blocks))
        whole[:, : spectrum.shape[1]] = spectrum
        return np.asarray(idct(whole, axis=-1, norm="ortho").T, dtype=np.float64)


class AttitudeSpace(Projection):
    """The space beside a fit against attitudes; see the module."""

    def __init__(
        self,
        pieces: Sequence[Piece],
        whiteners: Sequence[Whitener],
        noise: NoiseModel,
        extensions: Sequence[Extension] = (),
    ) -> None:
        """Take pieces, what whitens them and the causes that may follow.

        Args:
            pieces: of all recordings.
            whiteners: one a piece.
            noise: of all pieces, what `whiteners` rest on.
            extensions: causes whose effect is taken out, and that are fitted.
        """
        self.pieces, self.whiteners = tuple(pieces), tuple(whiteners)
        self._noise = noise
        self.recordings = 1 + max(one.recording for one in pieces)
        stretches = [
            Stretch(
                session=one.recording,
                used=(np.ones(one.blocks, dtype=np.bool_),),
                scenes=(one.scene,),
                exact=(one.scene,),
                models=(),
                residuals=(one.residual - effect_of(extensions, one.scene),),
                noise=noise,
            )
            for one in pieces
        ]
        columns = [self._columns(one, extensions) for one in pieces]
        white = [w.white(c) for w, c in zip(self.whiteners, columns, strict=True)]
        base = np.concatenate(white, axis=1)
        local = csr_array((0, base.shape[1]))
        super().__init__(stretches, tuple(extensions), base, local, self._known(extensions))

    @classmethod
    def beside(cls, settled: Settled, settings: Sequence[Setting], forces: "Forces") -> Self:
        """Return the space beside a settled fit.

        Args:
            settled: the fit.
            settings: of each recording.
            forces: of each recording.
        """
        pieces = _pieces(settled, settings, forces)
        noise, whiteners = _whiteners(pieces, settled.band_hz)
        return cls(pieces, whiteners, noise)

    def with_causes(self, extensions: Sequence[Extension]) -> "AttitudeSpace":
        """Return the space in which causes are taken out of the residual and may follow."""
        return AttitudeSpace(self.pieces, self.whiteners, self._noise, extensions)

    def widened(self, factor: float) -> "AttitudeSpace":
        """Return the space with every deviation wider by a factor."""
        wider = [replace(w, deviation=w.deviation * factor) for w in self.whiteners]
        return AttitudeSpace(self.pieces, wider, self._noise, self.extensions)

    def white(self, signals: Sequence[Sequence[FloatArray]]) -> FloatArray:
        """Return signals (k, blocks, 3) of each piece, whitened, (k, all)."""
        found = [w.white(own[0]) for w, own in zip(self.whiteners, signals, strict=True)]
        return np.concatenate(found, axis=1)

    def weighed(self) -> list[FloatArray]:
        """Return the residual weighed by the noise's inverse covariance, (n, 3) a piece."""
        return [
            w.weighed(own, one.blocks)
            for w, own, one in zip(
                self.whiteners, self._apart(self.residual), self.pieces, strict=True
            )
        ]

    def unwhitened(self, white: FloatArray) -> list[FloatArray]:
        """Return a whitened signal (all,) as rates in the band, (n, 3) a piece."""
        return [
            w.rate(own, one.blocks)
            for w, own, one in zip(self.whiteners, self._apart(white), self.pieces, strict=True)
        ]

    def windows(self, length_s: float) -> IntArray:
        """Return to which window each whitened value belongs, counted over all recordings."""
        found = []
        for one, w in zip(self.pieces, self.whiteners, strict=True):
            kept = w.scatter.size
            step_s = (one.time_s[-1] - one.time_s[0]) / max(1, one.blocks - 1) * one.blocks / kept
            time_s = one.scene.edges_s[0] + step_s * (np.arange(kept) + 0.5)
            own = np.floor(time_s / length_s).astype(np.int64)
            found.append(np.tile(own * self.recordings + one.recording, 3))
        return np.unique(np.concatenate(found), return_inverse=True)[1].astype(np.int64)

    def inflation(self, signals: Sequence[Signal]) -> float:
        """Return how much larger scores vary over chunks of time than the noise says.

        Args:
            signals: what a cause might look like; each column's own figure, their median.
        """
        white = np.concatenate([self.signals(of) for of in signals])
        left, chunks = self.left(self.residual), self.windows(CHUNK_S)
        ratios = []
        for column in white:
            own = self.left(column)
            if own @ own <= 1e-6 * (column @ column):
                continue
            score = np.bincount(chunks, own * left)
            ratios.append(float(score @ score) / float(own @ own))
        return max(1.0, float(np.median(ratios))) if ratios else 1.0

    def density(self, frequency_hz: FloatArray) -> FloatArray:
        """Return the noise's smooth one-sided density, (k, 3)."""
        return self._noise.density(frequency_hz)

    @property
    def band_hz(self) -> float:
        """Frequencies up to it take part."""
        one, whitener = self.pieces[0], self.whiteners[0]
        length_s = float(one.scene.edges_s[-1] - one.scene.edges_s[0])
        return whitener.scatter.size / (2.0 * length_s)

    @property
    def gain(self) -> FloatArray:
        """G of the fit that the space is beside, (3, 3)."""
        return self.pieces[0].scene.gain

    def best_step(self, gone: Sequence[int] = ()) -> FloatArray:
        """Return the step from the fit to the best beside the causes, (unknowns,).

        Args:
            gone: numbers of causes that are left out of the model.
        """
        everything = np.arange(self.residual.size)
        return np.asarray(self._fitted_to(everything, [self.without(gone)])[:, 0], np.float64)

    def remaining(self, gone: Sequence[int] = ()) -> list[FloatArray]:
        """Return what the best fit without some causes leaves of the band, (n, 3) a piece."""
        lacking = self.without(gone)
        return self.unwhitened(lacking.residual - self.best_step(gone) @ self._base)

    def in_band(self, of: Signal) -> list[FloatArray]:
        """Return one signal of each scene, (1, blocks, 3), as the band has it, (n, 3) a piece."""
        return self.unwhitened(self.signals(of)[0])

    def judged(self, gain: FloatArray, extensions: Sequence[Extension]) -> FloatArray:
        """Return the whitened residual of a gain and causes found elsewhere, (all,).

        Bias and lag are this space's own.

        Args:
            gain: G, shape (3, 3).
            extensions: as they were found.
        """
        off = (gain - self.gain).ravel() @ self._base[:GAINS]
        effect = self.signals(lambda scene: effect_of(extensions, scene)[None])[0]
        left = self.residual - off - effect
        own = self._base[GAINS : GAINS + PER_SESSION * self.recordings]
        step = np.linalg.lstsq(own.T, left, rcond=None)[0]
        return np.asarray(left - step @ own, dtype=np.float64)

    def _apart(self, white: FloatArray) -> list[FloatArray]:
        ends = np.cumsum([3 * w.scatter.size for w in self.whiteners])
        return np.split(white, ends[:-1])

    def _columns(self, one: Piece, extensions: Sequence[Extension]) -> FloatArray:
        """Return a piece's derivatives by G, each recording's (b, tau) and the causes."""
        own = columns_of(extensions, one.scene)
        after = GAINS + PER_SESSION * self.recordings
        found = np.zeros((after + own.shape[0], one.blocks, 3))
        first = GAINS + PER_SESSION * one.recording
        for axis in range(3):
            found[3 * axis : 3 * axis + 3, :, axis] = one.rate.T
            found[first + axis, :, axis] = 1.0
        # y is taken at t + tau: the model stays and y moves, so its slope has the other sign.
        found[first + 3] = -one.slope
        found[after:] = own
        return found

    def _known(self, extensions: Sequence[Extension]) -> Prior:
        each = [PRIOR_STD["bias"]] * 3 + [PRIOR_STD["time_offset"]]
        std = [PRIOR_STD["gain"]] * GAINS + each * self.recordings
        std += [float(v) for one in extensions for v in one.prior_std]
        size = len(std)
        return Prior(
            local=csc_array((0, 0)),
            cross=np.zeros((0, size)),
            shared=np.diag(np.array(std) ** -2.0),
            pull_local=np.zeros(0),
            pull_shared=np.zeros(size),
            first=GAINS + PER_SESSION * self.recordings,
            board=size,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Forces:
    """What each recording's accelerometer reads, None where it has none."""

    readings: tuple[tuple[FloatArray, FloatArray] | None, ...]  # time (n,), force (n, 3)

    def at(self, recording: int, time_s: FloatArray) -> FloatArray | None:
        """Return the force at some times, (m, 3), straight between readings."""
        own = self.readings[recording]
        if own is None:
            return None
        return np.stack([np.interp(time_s, own[0], axis) for axis in own[1].T], axis=1)


def _pieces(settled: Settled, settings: Sequence[Setting], forces: Forces) -> list[Piece]:
    work = settled.work
    inverse = np.linalg.inv(work.gain).T
    found = []
    for k, (stretch, recording) in enumerate(zip(work.stretches, settled.recording, strict=True)):
        track = stretch.track
        thin = max(1, int(FINE_S / track.step_s))
        step_s = thin * track.step_s
        block = max(1, int(1.0 / (FINER * settled.band_hz * step_s)))
        many = track.begin_s.size // (block * thin)
        if many * block * step_s < SHORTEST_S:
            continue
        clean = work.cleaned(k)
        n = many * block * thin
        rate = _means((clean.measured[:n] - work.bias) @ inverse, thin)
        edges_s = np.append(track.begin_s[:n:thin], track.end_s[n - 1])
        middle_s = (edges_s[:-1] + edges_s[1:]) / 2.0
        scene = AttitudeScene.build(
            edges_s,
            None,
            np.ones(many * block, dtype=np.bool_),
            block=block,
            fine=1,
            bandwidth_hz=None,
            gain=work.gain,
            bias_rad_s=work.bias,
            rate_rad_s=rate,
            setting=settings[recording],
        )
        scene = replace(scene, force_m_s2=forces.at(recording, middle_s + work.lag_s))
        measured = _means(clean.measured[:n], block * thin)
        found.append(
            Piece(
                recording=recording,
                scene=scene,
                measured=measured,
                modelled=measured - _means(clean.residual[:n], block * thin),
                rate=_means(rate, block),
                slope=_means(clean.slope[:n], block * thin),
                time_s=middle_s.reshape(many, block).mean(axis=1),
                kept=int(2.0 * settled.band_hz * many * block * step_s),
            )
        )
    return found


def _means(values: FloatArray, of: int) -> FloatArray:
    """Return means of so many rows each, (n / of, 3)."""
    return np.asarray(values.reshape(-1, of, 3).mean(axis=1), dtype=np.float64)


def _whiteners(pieces: Sequence[Piece], band_hz: float) -> tuple[NoiseModel, list[Whitener]]:
    """Return the noise's smooth model, and what whitens each piece."""
    step_s = float(np.median([np.median(np.diff(one.time_s)) for one in pieces]))
    rate_hz = 1.0 / step_s
    sampling = Sampling(rate_hz, 1, None, 0.0, differentiated=True)
    pooled = [Periodogram.of(one.residual, rate_hz).between(0.0, band_hz) for one in pieces]
    noise = fit_levels(binned(pooled), sampling)
    power, smooth, frequency = [], [], []
    for one in pieces:
        # A series' constant stands for what is slower than its first wave.
        f = np.maximum(np.arange(one.kept), 0.5) * rate_hz / (2.0 * one.blocks)
        frequency.append(f)
        smooth.append(noise.density(f) * rate_hz / 2.0)
        power.append(dct(one.residual, axis=0, norm="ortho")[: one.kept] ** 2)
    level = level_by_bins(np.concatenate(power) / np.concatenate(smooth), np.concatenate(frequency))
    ends = np.cumsum([one.kept for one in pieces])[:-1]
    found = []
    for one, own, usual in zip(pieces, np.split(level, ends), smooth, strict=True):
        plain = Whitener(np.sqrt(own * usual), np.ones(one.kept))
        found.append(_even(one, plain))
    return noise, found


def _even(one: Piece, whitener: Whitener) -> Whitener:
    """Return the same with each moment weighed by the scatter about it."""
    white = whitener.white(one.residual[None]).reshape(3, -1)
    power = np.mean(white**2, axis=0)
    step_s = float(one.time_s[-1] - one.time_s[0]) / power.size
    width = max(round(LOCAL_S / step_s), LOCAL_VALUES // 3)
    scatter = np.sqrt(_running_mean(power, min(width, power.size)))
    return replace(whitener, scatter=np.maximum(scatter, LEAST_SCATTER))


def _running_mean(values: FloatArray, width: int) -> FloatArray:
    """Return the mean of so many values around each, (n,); the ends last beyond themselves."""
    before = width // 2
    whole = np.pad(values, (before, width - 1 - before), mode="edge")
    total = np.concatenate([[0.0], np.cumsum(whole)])
    return np.asarray(np.maximum(total[width:] - total[:-width], 0.0) / width, dtype=np.float64)
