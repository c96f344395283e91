"""Choice of the templates of a cause that are scanned in a residual.

What to use when: `quick_templates` for a scan of the catalogue, `all_templates` for one cause. For
lost steps, which are short, and for spectral lines, which are narrow, both return only the
templates at peaks of the residual. A pulse in missing samples, for example in saturated ones, has
no peak. After a loss on tilt, the stage leans from then on, so that each such gap has a template.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.lag_series import lag_templates
from gyrorig_solver.estimate import NuisanceProjector
from gyrorig_solver.model import Term, is_active_in, start_values, value_indices

MIN_PERIODS = 3.0  # of a spectral line in a recording; fewer periods look like a drift
QUICK_TEMPLATES = 20  # templates of a cause in the scan of the catalogue
MAX_PEAKS = 12  # pulses or lines that are taken from a residual
MIN_SEPARATION_S = 0.1  # between two pulses; closer pulses count as one
# Scanned pulses per independent test: there are two pulses per block, each two blocks wide.
PULSES_PER_TRIAL = 4
SPECTRUM_OVERSAMPLING = 4  # points of the spectrum per bin of a periodogram


def folded_periods(frequency_hz: FloatArray, rate_hz: float, length_s: float) -> FloatArray:
    """Return the number of periods of spectral lines in a recording, after aliasing.

    Args:
        frequency_hz: true frequencies.
        rate_hz: sampling rate.
        length_s: duration of the recording.
    """
    folded = np.abs((frequency_hz + rate_hz / 2.0) % rate_hz - rate_hz / 2.0)
    return np.asarray(folded * length_s, dtype=np.float64)


def quick_templates(projection: NuisanceProjector, term: Term) -> tuple[FloatArray, int]:
    """Return templates (b, k) for a scan of the catalogue, and the number of scanned templates.

    They are some templates of a grid, and all templates of any other kind. For example, a mode is
    as narrow as its damping, so that no other template shows it.
    """
    templates, scanned = all_templates(projection, term)
    if term.template_search != "grid":
        return templates, scanned
    sizes = np.abs(templates[:, value_indices(term, role="size")]).max(axis=1)
    if (sizes == 0.0).any():
        templates = templates[sizes == 0.0]
    chosen = np.unique(
        np.round(np.linspace(0, len(templates) - 1, QUICK_TEMPLATES)).astype(np.int64)
    )
    return templates[chosen], len(templates)


def all_templates(projection: NuisanceProjector, term: Term) -> tuple[FloatArray, int]:
    """Return all templates (b, k), and the number of scanned templates.

    For pulses, lines and lags, the templates are those that fit the residual best.
    """
    if term.template_search == "pulses":
        return _lost_step_templates(projection, term)
    if term.template_search == "spectral_lines":
        return _line_templates(projection, term)
    if term.template_search == "lag_series":
        return lag_templates(projection, term)
    banks = [term.template_bank(scene) for scene in projection.states]
    templates = np.unique(np.concatenate(banks), axis=0)
    return templates, len(templates)


def _lost_step_templates(projection: NuisanceProjector, term: Term) -> tuple[FloatArray, int]:
    times, gains, scanned = [], [], 0
    unseen: list[FloatArray] = []
    for scene, whitened_residual in zip(
        projection.states_before(term), projection.weighted_residual(), strict=True
    ):
        if not scene.has_angles or not is_active_in(term, scene):
            continue
        candidates = term.pulse_templates(scene)
        span = candidates.first_block[:, None] + np.arange(candidates.values.shape[1])
        score = np.einsum("rmi,rmi->r", whitened_residual[span], candidates.values)
        energy = np.einsum("rmi,rmi->r", candidates.values, candidates.values)
        time_s = scene.true_times_s(candidates.time_s)
        times.append(time_s)
        gains.append(score**2 / np.maximum(energy, 1e-30))
        scanned += candidates.time_s.size
        is_unseen = ~np.any(whitened_residual[span], axis=(1, 2))
        leaves_lean = candidates.axis == 1  # tilt
        unseen.append(_middles_of_runs(time_s[is_unseen & leaves_lean]))
    templates = np.tile(start_values(term), (MAX_PEAKS, 1))
    time_s, gain = np.concatenate(times), np.concatenate(gains)
    event = value_indices(term, role="event")[0]
    count = 0
    while count < MAX_PEAKS and gain.size:
        best = int(np.argmax(gain))
        templates[count, event] = time_s[best]
        keep = np.abs(time_s - time_s[best]) > MIN_SEPARATION_S
        time_s, gain, count = time_s[keep], gain[keep], count + 1
    unseen_s = np.concatenate(unseen)
    unseen_templates = np.tile(start_values(term), (unseen_s.size, 1))
    unseen_templates[:, event] = unseen_s
    chosen = np.concatenate([templates[:count], unseen_templates])
    return chosen, max(1, scanned // PULSES_PER_TRIAL) + unseen_s.size


def _middles_of_runs(time_s: FloatArray) -> FloatArray:
    """Return the middle time of each run of ascending times without a large gap, shape (r,)."""
    runs = np.split(time_s, np.flatnonzero(np.diff(time_s) > MIN_SEPARATION_S) + 1)
    return np.array([run[run.size // 2] for run in runs if run.size])


def _line_templates(projection: NuisanceProjector, term: Term) -> tuple[FloatArray, int]:
    acting = [k for k, scene in enumerate(projection.states) if is_active_in(term, scene)]
    scene, whitened_residual = (
        projection.states[acting[0]],
        projection.weighted_residual()[acting[0]],
    )
    templates = term.template_bank(scene)
    frequency = value_indices(term, role="shape")[0]
    length_s = float(scene.edges_s[-1] - scene.edges_s[0])
    rate_hz = whitened_residual.shape[0] / length_s
    aliased = folded_periods(templates[:, frequency], rate_hz, length_s)
    templates, aliased = templates[aliased >= MIN_PERIODS], aliased[aliased >= MIN_PERIODS]
    power = (
        np.abs(
            np.fft.rfft(
                whitened_residual, SPECTRUM_OVERSAMPLING * whitened_residual.shape[0], axis=0
            )
        )
        ** 2
    )
    bins = np.minimum(np.round(aliased * SPECTRUM_OVERSAMPLING), power.shape[0] - 1)
    # An axis without any residual has no spectrum.
    relative = power / np.maximum(np.mean(power, axis=0), np.finfo(np.float64).tiny)
    order = np.argsort(-relative[bins.astype(np.int64)].sum(axis=1), kind="stable")
    return templates[order[:MAX_PEAKS]], len(templates)
