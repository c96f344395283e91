"""Signals of the causes of a fit, at the states of all parts of its series, whitened.

What to use when: `evaluate_signals` for a function of a state, `term_derivatives` for a cause,
`unwhiten` for the rates of a whitened signal.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct, idct

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.estimate.cascade import TermCascade
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.linear.whitening import PartModel
from gyrorig_solver.estimate.series_segment import SeriesSegment, SignalWhitener
from gyrorig_solver.estimate.whitened_signals import WhitenedSignals
from gyrorig_solver.model import Signals, SignalState, Term, dense_signals, term_label

SignalFunction = Callable[[SignalState], Signals]


@dataclass(slots=True)
class SignalCount:
    """The number of signals that were whitened, for example in one search."""

    signals: int = 0


class SegmentSignals:
    """The signals at the states of a fit's segments, behind its causes."""

    def __init__(
        self, segments: Sequence[SeriesSegment], active_terms: Sequence[FittedTerm]
    ) -> None:
        """Start without cached states.

        Args:
            segments: the series of the fit.
            active_terms: causes whose effect is removed from the residual.
        """
        self.segments = tuple(segments)
        self._cascades = [
            [TermCascade(active_terms, state) for state in segment.states] for segment in segments
        ]
        self._exact_cascades = [
            [TermCascade(active_terms, state) for state in segment.exact_states]
            for segment in segments
        ]
        self._cached_term = ""
        self.signal_count = SignalCount()  # several projectors can share it

    @property
    def states(self) -> list[SignalState]:
        """The signal states of all parts."""
        return [state for segment in self.segments for state in segment.states]

    def states_before(self, term: Term) -> list[SignalState]:
        """Return the signal state of each part at a term's input, with all filters and delays."""
        parts = self._cascades_of(term, exact=False)
        return [cascade.state_before(term) for part in parts for cascade in part]

    def whiten(self, signals: Sequence[Sequence[Signals]]) -> WhitenedSignals:
        """Return signals of each part of each series, whitened."""
        self.signal_count.signals += len(signals[0][0])
        channels = [
            channel
            for segment, parts in zip(self.segments, signals, strict=True)
            for channel in segment.whiten(parts)
        ]
        return WhitenedSignals(len(signals[0][0]), tuple(channels))

    def evaluate_signals(
        self, function: SignalFunction, exact: bool = False, term: Term | None = None
    ) -> WhitenedSignals:
        """Evaluate a function of each state, (k, blocks, 3), and whiten it.

        Args:
            function: of a state; its signals, (k, blocks, 3).
            exact: use the states on the samples' own grid.
            term: use the states at this term's input, with the earlier causes of the fit applied;
                None: use the states without causes.
        """
        return self.whiten(self._signals_of(function, exact, term))

    def evaluate_together(
        self, functions: Sequence[SignalFunction], count: int, term: Term | None = None
    ) -> WhitenedSignals:
        """Return `count` signals of several functions in sequence, whitened.

        The signals have single precision; `evaluate_signals` returns them in double precision.
        """
        self.signal_count.signals += count
        whiteners = [SignalWhitener(segment, count, np.float32) for segment in self.segments]
        for function in functions:
            for whitener, parts in zip(
                whiteners, self._signals_of(function, False, term), strict=True
            ):
                whitener.add(parts)
        channels = (channel for whitener in whiteners for channel in whitener.finish())
        return WhitenedSignals(count, tuple(channels))

    def _signals_of(
        self, function: SignalFunction, exact: bool, term: Term | None
    ) -> list[list[Signals]]:
        """Return the signals of each part of each series."""
        if term is None:
            return [
                [function(state) for state in (segment.exact_states if exact else segment.states)]
                for segment in self.segments
            ]
        return [
            [
                cascade.apply_pass_through(
                    term, dense_signals(function(cascade.state_before(term)))
                )
                for cascade in part
            ]
            for part in self._cascades_of(term, exact)
        ]

    def term_derivatives(
        self, term: Term, values: FloatArray, free: IntArray | Sequence[int]
    ) -> WhitenedSignals:
        """Return a term's derivatives, followed by its joint effect, whitened and exact.

        Args:
            term: the cause.
            values: of all its parameters, (k,).
            free: indices of the values for the derivatives.
        """
        segments = []
        for part in self._cascades_of(term, exact=True):
            signals = []
            for cascade in part:
                columns = cascade.apply_pass_through(
                    term, term.jacobian(cascade.state_before(term), values)[free]
                )
                signals.append(np.concatenate([columns, cascade.joint_effect(term, values)[None]]))
            segments.append(signals)
        return self.whiten(segments)

    def _cascades_of(self, term: Term, exact: bool) -> list[list[TermCascade]]:
        """Return the cascades of each part; exact ones keep the states of one term only."""
        if exact and self._cached_term != term_label(term):
            for cascade in (cascade for part in self._exact_cascades for cascade in part):
                cascade.clear_cache()
            self._cached_term = term_label(term)
        return self._exact_cascades if exact else self._cascades

    def unwhiten(self, white_signal: FloatArray) -> list[FloatArray]:
        """Return a whitened signal (all,) as rates, (n, 3) per part; 0 where unused."""
        rates = []
        for segment, model, white in self.split_parts(white_signal):
            std = np.sqrt(segment.noise.dct_variance(model.used.size)).T
            spectrum = dct(white, axis=-1, norm="ortho")
            if model.relative_std is not None:
                spectrum = model.relative_std.multiply_spectra(spectrum)
            rate = idct(spectrum * std, axis=-1, norm="ortho").T
            rates.append(np.where(model.used[:, None], rate, 0.0))
        return rates

    def split_parts(
        self, signal: FloatArray
    ) -> Iterator[tuple[SeriesSegment, PartModel, FloatArray]]:
        """Yield the segment and model of each part, with its piece (3, n) of a signal (all,)."""
        start = 0
        for segment in self.segments:
            for model in segment.models:
                stop = start + 3 * model.used.size
                yield segment, model, signal[start:stop].reshape(3, -1)
                start = stop
