"""Cross-validation: the gain of an extended model on data that it was not fitted to.

The recording is divided into windows of some moves each. Each fold of windows is left out in turn:
gain, bias, time offset and causes are fitted to the others. In the left-out windows, both models
fit only the unknowns of the motion, such as the start of a move. A whole recording can be left out
too (`held_out_recording`).

What to use when: `cross_validate_causes` for the causes of a fit, all together and one by one;
`gain_on_recording` for a second recording.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.discover.cause_findings import ConfidenceInterval, HeldOutGain
from gyrorig_solver.discover.held_out_recording import HeldOutRecording
from gyrorig_solver.estimate import ConvergedFit, NuisanceProjector
from gyrorig_solver.numerics import normal_quantile

WINDOW_S = 10.0
FOLDS = 8  # groups of windows; each fit leaves out one of them
MIN_WINDOWS = 4  # fewer windows give no useful interval
SETTLE_S = 0.3  # time after a move in which the low-pass output still contains the move


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutGains:
    """The gains of a fit's causes on held-out windows."""

    combined: HeldOutGain
    by_cause: Mapping[int, HeldOutGain]  # by index of the cause in the fit; the others stay


def cross_validate_causes(
    projector: NuisanceProjector, causes: Sequence[int]
) -> HeldOutGains | None:
    """Return the cross-validated gain of causes of a fit; None without causes or with few windows.

    Args:
        projector: the nuisance projector at the fit, with all of its causes.
        causes: their indices in the fit; the other causes belong to the base model.
    """
    windows = _window_numbers(projector, projector.channel_lengths[::3])
    count = int(windows.max()) + 1
    if count < MIN_WINDOWS or not causes:
        return None
    dropped: list[Sequence[int]] = [[], causes]
    if len(causes) > 1:
        dropped += [[k] for k in causes]
    models = [projector.drop_terms(dropped_causes) for dropped_causes in dropped]
    full, *reduced = projector.held_out_residuals(windows % min(FOLDS, count), models)
    how = f"{count} windows of {WINDOW_S:.0f} s, each left out of one fit"
    gains = [
        compare_residuals(projector, how, reduced_residual, full) for reduced_residual in reduced
    ]
    separate = gains[1:] if len(causes) > 1 else gains
    return HeldOutGains(gains[0], dict(zip(causes, separate, strict=True)))


def gain_on_recording(
    base: ConvergedFit,
    extended: ConvergedFit,
    held_out: HeldOutRecording,
) -> HeldOutGain:
    """Return the gain of an extended model on a recording that neither model was fitted to.

    Args:
        base: a fit of the base model to other recordings of the board.
        extended: a fit of the extended model to the same recordings.
        held_out: the recording.
    """
    extended_fit = held_out.fit_model(extended)
    base_fit = held_out.fit_model(base, same_noise_as=extended_fit)
    projector = NuisanceProjector.at_fit(
        replace(
            extended,
            sessions=(extended_fit.session,),
            fitted_terms=extended_fit.session.fitted_terms,
            noises=(extended_fit.noise,),
        )
    )
    whitened = []
    for fit in (base_fit, extended_fit):
        pairs = zip(fit.session.series, fit.session.residuals(fit.gain), strict=True)
        parts = [[rates[p][None] for p in series.part_slices()] for series, rates in pairs]
        whitened.append(projector.whiten(parts).dense()[0])
    how = f"the recording {held_out.name}, in which only bias and time offset were fitted"
    left_out = ", ".join(fit.term.cause for fit in extended_fit.left_out)
    if left_out:
        how += f"; without the causes that only the other recording has: {left_out}"
    gain = compare_residuals(projector, how, *whitened)
    # The likelihood also contains the deviation of the motion from its prior.
    gain_nats = extended_fit.log_likelihood - base_fit.log_likelihood
    window_gain = gain.log_likelihood
    shift = gain_nats - window_gain.value
    return replace(
        gain,
        log_likelihood=ConfidenceInterval(
            gain_nats, window_gain.low + shift, window_gain.high + shift
        ),
    )


def compare_residuals(
    projection: NuisanceProjector, how: str, before: FloatArray, after: FloatArray
) -> HeldOutGain:
    """Return the gain of one model over another from their whitened residuals on held-out data.

    Args:
        projection: the nuisance projector at a fit to these data.
        how: which data they are.
        before: whitened residual of the first model, (all,).
        after: whitened residual of the second model, (all,).
    """
    windows = _window_numbers(projection, projection.channel_lengths[::3])
    count = int(windows.max()) + 1
    costs = [np.bincount(windows, residual**2, count) for residual in (before, after)]
    nats = np.asarray(0.5 * (costs[0] - costs[1]), dtype=np.float64)
    rates = [projection.unwhiten(residual) for residual in (before, after)]
    squares = [_window_mean_squares(projection, rate) for rate in rates]
    used = sum(int(u.sum()) for s in projection.segments for u in s.used)
    rms = [float(np.sqrt(sum(np.sum(r**2) for r in rate) / (3 * used))) for rate in rates]
    turns = [_turn_error_squares(projection, rate) for rate in rates]
    errors = [float(np.sqrt(np.mean(t))) if t.size else float("nan") for t in turns]
    return HeldOutGain(
        how=how,
        log_likelihood=_confidence_interval(nats, float(np.sum(nats)), float(count)),
        rms_before=rms[0],
        rms_after=rms[1],
        turn_error_before_rad=errors[0],
        turn_error_after_rad=errors[1],
        rms_change=_confidence_interval(
            squares[1] - squares[0], rms[1] - rms[0], 1.0 / (rms[0] + rms[1])
        ),
        turn_change=_rms_change(turns, errors),
    )


def _rms_change(squares: list[FloatArray], errors: list[float]) -> ConfidenceInterval | None:
    """Return the change of an rms over moves.

    Args:
        squares: of each move, before and after, (moves,).
        errors: the rms before and after.
    """
    if squares[0].size < MIN_WINDOWS:
        return None
    differences = squares[1] - squares[0]
    return _confidence_interval(differences, errors[1] - errors[0], 1.0 / (errors[0] + errors[1]))


def _confidence_interval(samples: FloatArray, value: float, factor: float) -> ConfidenceInterval:
    """Return a value with its 95 % interval from the scatter over the windows."""
    if samples.size < 2:
        return ConfidenceInterval(value, float("nan"), float("nan"))
    half = normal_quantile(0.025) * float(np.std(samples, ddof=1) / np.sqrt(samples.size)) * factor
    return ConfidenceInterval(value, value - half, value + half)


def _window_numbers(projection: NuisanceProjector, lengths: Sequence[int]) -> IntArray:
    """Return the window number of each value, in order of part and axis.

    The numbers continue over all recordings. `lengths`: values of each part on one axis.
    """
    numbers, first = [], 0
    for state, length in zip(projection.states, lengths, strict=True):
        count = max(1, round(float(state.edges_s[-1] - state.edges_s[0]) / WINDOW_S))
        numbers.append(np.tile(first + np.arange(length) * count // length, 3))
        first += count
    return np.concatenate(numbers).astype(np.int64)


def _window_mean_squares(projection: NuisanceProjector, rates: list[FloatArray]) -> FloatArray:
    """Return the mean square of each window, (windows,)."""
    windows = _window_numbers(projection, [len(rate) for rate in rates])
    flat = np.concatenate([rate.T.ravel() for rate in rates])
    return np.asarray(
        np.bincount(windows, flat**2) / np.maximum(np.bincount(windows), 1), dtype=np.float64
    )


def _turn_error_squares(projection: NuisanceProjector, rates: list[FloatArray]) -> FloatArray:
    """Return the square of the residual's integral over each move, rad^2, (moves,)."""
    turn_errors, part = [], 0
    for s in projection.segments:
        for scene, used in zip(s.states, s.used, strict=True):
            rate = rates[part]
            part += 1
            step_s = float(scene.edges_s[-1] - scene.edges_s[0]) / used.size
            for _, course in scene.context.motion_profiles:
                first = round((float(course.start_s[0]) - float(scene.edges_s[0])) / step_s)
                last = round((float(course.end_s) + SETTLE_S - float(scene.edges_s[0])) / step_s)
                if 0 <= first < last <= used.size:
                    turn_errors.append(np.sum(rate[first:last], axis=0) * step_s)
    return np.sum(np.square(turn_errors), axis=1) if turn_errors else np.zeros(0)
