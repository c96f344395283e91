"""The noise of one recording at rest, from the spectrum of its residual.

What to use when: `fit_session_noise` at a fit; `session_periodograms` for only the spectrum.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.noise.missing_samples import incomplete_densities
from gyrorig_solver.estimate.noise.noise_estimation import (
    ResidualSegment,
    noise_periodograms,
    resting_blocks,
)
from gyrorig_solver.estimate.noise.noise_floor import DIFFERENCE_ORDER, add_noise_floor
from gyrorig_solver.estimate.noise.noise_levels import fit_noise_levels
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, Sampling
from gyrorig_solver.estimate.noise.residual_spectrum import Periodogram, Spectrum, bin_spectrum
from gyrorig_solver.estimate.noise.rest_noise import RestDifferences, limit_to_rest
from gyrorig_solver.estimate.session_fit import SessionFit


@dataclass(frozen=True, slots=True, eq=False)
class SessionNoise:
    """The noise of one recording, and its origin."""

    noise: NoiseModel
    spectrum: Spectrum  # of the residual
    source: str  # the part of the recording that was used


def session_periodograms(
    session: SessionFit, gain: FloatArray, sampling: Sampling | None = None
) -> tuple[list[Periodogram], str]:
    """Return the residual's periodograms, and a description of the part they use.

    Unmodelled motion would look like noise. If there are enough rests, the frequencies that they
    resolve come only from the rests.

    Args:
        session: the recording.
        gain: G, shape (3, 3).
        sampling: of the residual; by default that of the session.
    """
    segments = [
        ResidualSegment(
            residual, used, moving, series.part_slices(), relative_variance, used_samples
        )
        for series, residual, used, moving, relative_variance, used_samples in zip(
            session.series,
            session.residuals(gain),
            session.used,
            session.moving,
            session.relative_variances,
            session.used_samples,
            strict=True,
        )
    ]
    return noise_periodograms(segments, sampling or session.sampling)


def fit_session_noise(
    session: SessionFit,
    gain: FloatArray,
    sampling: Sampling,
    initial_levels: FloatArray | None = None,
    is_next_step: bool = False,
) -> SessionNoise:
    """Estimate the noise at rest from the residual's spectrum.

    Args:
        session: the recording.
        gain: G, shape (3, 3).
        sampling: of the residual.
        initial_levels: (3, 4), from a previous fit.
        is_next_step: whether they are those before a step of the same fit.
    """
    periodograms, source = session_periodograms(session, gain, sampling)
    spectrum = bin_spectrum(periodograms, sampling)
    incomplete = np.mean(
        [incomplete_densities(used, sampling) for used in session.used_samples], axis=0
    )
    noise = replace(
        fit_noise_levels(spectrum, sampling, initial_levels), incomplete=np.asarray(incomplete)
    )
    at_rest = [
        resting_blocks(used, moving, session.sampling.rate_hz)
        for used, moving in zip(session.used, session.moving, strict=True)
    ]
    residuals = session.residuals(gain)
    differences = RestDifferences.of(residuals, at_rest)
    high_differences = RestDifferences.of(residuals, at_rest, DIFFERENCE_ORDER)
    with_floor = add_noise_floor(noise, spectrum, high_differences)
    # A floor is a part of the noise at rest. Without it, the white noise at rest seems too large.
    previous_levels = initial_levels if is_next_step else None
    if limit_to_rest(with_floor, differences, previous_levels) is not with_floor:
        limited = limit_to_rest(noise, differences, previous_levels)
        return SessionNoise(limited, spectrum, source)
    return SessionNoise(with_floor, spectrum, source)
