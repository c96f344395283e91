"""Held-out gain of causes with reference attitudes, on left-out time windows.

What to use when: `gains` for the causes of a space, all together and one by one; `gain_of` for
any two models' residuals.
"""

import numpy as np

from gyrorig_solver.data.arrays import FloatArray, IntArray
from gyrorig_solver.discover.attitude.attitude_terms import UNNAMED_TERMS
from gyrorig_solver.discover.cause_findings import ConfidenceInterval, HeldOutGain
from gyrorig_solver.estimate.attitude.attitude_projector import AttitudeProjector
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.numerics import normal_quantile

WINDOW_S, FOLDS, MIN_WINDOWS = 10.0, 8, 4


def cross_validate_space(
    space: AttitudeProjector,
) -> tuple[HeldOutGain | None, list[HeldOutGain] | None]:
    """Return the cross-validated gain of all named causes, and of each term.

    None where nothing is named, or where there are too few windows.
    """
    windows = space.window_numbers(WINDOW_S)
    count, term_count = int(windows.max()) + 1, len(space.fitted_terms)
    if count < MIN_WINDOWS or not term_count:
        return None, None
    named = [k for k, extension in enumerate(space.fitted_terms) if is_named_cause(extension)]
    models = [
        space.drop_terms(dropped) for dropped in ((), named, *([k] for k in range(term_count)))
    ]
    full, *reduced = space.held_out_residuals(windows % min(FOLDS, count), models)
    how = f"{count} windows of {WINDOW_S:.0f} s, each left out of one fit"
    gains = [gain_between(space, windows, how, before, full) for before in reduced]
    return gains[0] if named else None, gains[1:]


def gain_between(
    space: AttitudeProjector, windows: IntArray, how: str, before: FloatArray, after: FloatArray
) -> HeldOutGain:
    """Return the gain of one model over another from whitened residuals, (all,) each."""
    nats: FloatArray = np.asarray(0.5 * np.bincount(windows, before**2 - after**2), np.float64)
    rates = [np.concatenate(space.unwhiten(residual)) for residual in (before, after)]
    rms = [float(np.sqrt(np.mean(rate**2))) for rate in rates]
    change = rms[1] - rms[0]
    blocks = np.minimum(
        np.arange(rates[0].shape[0]) * nats.size // rates[0].shape[0], nats.size - 1
    )
    squares: FloatArray = np.bincount(blocks, np.sum(rates[1] ** 2 - rates[0] ** 2, axis=1)) / (
        3 * np.maximum(np.bincount(blocks), 1)
    )
    return HeldOutGain(
        how=how,
        log_likelihood=_confidence_interval(nats, float(nats.sum()), float(nats.size)),
        rms_before=rms[0],
        rms_after=rms[1],
        turn_error_before_rad=float("nan"),
        turn_error_after_rad=float("nan"),
        rms_change=_confidence_interval(squares, change, 1.0 / (rms[0] + rms[1])),
    )


def _confidence_interval(samples: FloatArray, value: float, factor: float) -> ConfidenceInterval:
    half = normal_quantile(0.025) * float(np.std(samples, ddof=1) / np.sqrt(samples.size)) * factor
    return ConfidenceInterval(value, value - half, value + half)


def is_named_cause(extension: FittedTerm) -> bool:
    """Return whether a term is a cause, not an unnamed effect."""
    return extension.term.cause not in UNNAMED_TERMS
