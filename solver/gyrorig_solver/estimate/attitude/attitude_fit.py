"""Fit of gain, bias and time offset to a reference attitude, in the rate domain.

What to use when: `solve_attitude` for the iterations of the fit; `attitude_summary.fit_attitude`
for the fit with its summary.

Theory of operation. Over each step of the reference, y(t + tau) = G w(t) + b + noise. Above a few
Hz, differentiated motion capture is far noisier than the gyro, and a noisy w as a regressor biases
G towards zero (least squares on the data set `broad` gives G = 0). Therefore w is replaced by the
best estimate of the true rate from both sides, w + S_w G' (G S_w G' + S_y)^-1 (y - G w - b), whose
error is uncorrelated with the residual (Deming's regression, per frequency). The computation is in
the DCT domain. The residual's density, estimated in bins, weights each frequency. Only frequencies
up to `DEFAULT_BAND_HZ` are used: a gain and a delay describe a sensor at low frequencies. At higher
frequencies, its low-pass and the smoothing of the reference differ (measured on `broad` 07: +1 to
+2 % at 5 Hz, +3 to +4 % at 8 Hz, -4 to +6 % at 14 Hz).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.attitude.attitude_matching import AttitudeSegment, match_segments
from gyrorig_solver.estimate.attitude.attitude_solver import LAG_LIMIT_S, AttitudeSolver
from gyrorig_solver.estimate.attitude.attitude_times import (
    ResolvedReference,
    no_common_stretch,
    resolve_times,
)
from gyrorig_solver.estimate.attitude.linearised_model import LinearisedModel
from gyrorig_solver.estimate.attitude.shared_noise import shared_noise_reasons
from gyrorig_solver.estimate.attitude.time_shift import check_rate_unit, check_time_shift
from gyrorig_solver.estimate.information import PARAMETER_NAMES
from gyrorig_solver.estimate.observability import (
    analyse_scaled_observability,
)
from gyrorig_solver.estimate.rest_mean import mean_std_by_rounding
from gyrorig_solver.reference import AttitudeReference

DEFAULT_BAND_HZ = 5.0
# Share of the band for a second fit, and the standard deviations within which both must agree.
LOWER_BAND_SHARE = 0.2
MAX_BAND_DIFFERENCE_SIGMA = 4.0
MIN_COEFFICIENTS = 8.0  # of each axis in the lower band; the fit has four parameters per axis


@dataclass(frozen=True, slots=True)
class _BandComparison:
    """Comparison of the gains of the band and of a lower band."""

    std_factor: float  # 1 if the bands agree
    limited_reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeFit:
    """The end of the iterations, before the summary."""

    solver: AttitudeSolver
    linearised: LinearisedModel
    bands: _BandComparison
    band_hz: float  # lower than requested if the bands disagree
    resolved: tuple[ResolvedReference, ...]  # of each recording
    rounding_std_rad_s: FloatArray  # (recordings, 3), what rounding adds to each bias
    shared_noise_reasons: tuple[str, ...] = ()  # to refuse attitudes computed from the gyro

    @property
    def offset_recording(self) -> int:
        """The recording of the time offset: the last one that shows it. A rest does not."""
        last = len(self.solver.biases) - 1
        return max(self.solver.recordings_with_lag(self.linearised), default=last)

    @property
    def estimate(self) -> FloatArray:
        """G, b of the last recording, and tau of `offset_recording`, shape (13,)."""
        solver = self.solver
        lag_s = solver.lags_s[[self.offset_recording]]
        return np.concatenate([solver.gain.ravel(), solver.biases[-1], lag_s])


def solve_attitude(
    recordings: Sequence[tuple[GyroSamples, AttitudeReference]],
    band_hz: float = DEFAULT_BAND_HZ,
    keep_sawtooth: bool = False,
) -> AttitudeFit:
    """Run the iterations of the fit; see `attitude_summary.fit_attitude`.

    Args:
        recordings: samples and attitudes, each pair on one time axis.
        band_hz: higher frequencies are not used.
        keep_sawtooth: leave the saw-tooth of a clock in the times, for a search for causes.

    Raises:
        InputError: gyro and reference hardly overlap.
    """
    for samples, reference in recordings:
        check_time_shift(samples, reference)
        check_rate_unit(samples, reference)
    resolved = resolve_all(recordings, band_hz, keep_sawtooth)
    matches = [
        (recording_index, match_of_track)
        for recording_index, ((samples, _), outcome) in enumerate(
            zip(recordings, resolved, strict=True)
        )
        for match_of_track in match_segments(samples, outcome.reference)
    ]
    matched = {recording_index for recording_index, _ in matches}
    for recording_index, (samples, reference) in enumerate(recordings):
        if recording_index not in matched:
            raise no_common_stretch(samples, reference, recording_index, len(recordings))
    segments = [match_of_track for _, match_of_track in matches]
    rounding_std = np.array([mean_std_by_rounding(samples) for samples, _ in recordings])
    fit = _solve_segments(segments, [k for k, _ in matches], band_hz, None, resolved, rounding_std)
    used = [
        (samples, outcome.reference)
        for (samples, _), outcome in zip(recordings, resolved, strict=True)
    ]
    return replace(fit, shared_noise_reasons=shared_noise_reasons(fit.solver, used))


def resolve_all(
    recordings: Sequence[tuple[GyroSamples, AttitudeReference]],
    band_hz: float,
    keep_sawtooth: bool = False,
) -> tuple[ResolvedReference, ...]:
    """Return each recording's reference on the times of the fit.

    A recording that is too short to show differences between the times keeps its times.

    Raises:
        InputError: jitter hides which frames of a reference are missing.
    """
    return tuple(
        resolve_times(samples, reference, band_hz, keep_sawtooth)
        if _coefficients(match_segments(samples, reference), LOWER_BAND_SHARE * band_hz)
        >= MIN_COEFFICIENTS
        else ResolvedReference(reference)
        for samples, reference in recordings
    )


def _coefficients(segments: Sequence[AttitudeSegment], band_hz: float) -> float:
    """Return the number of coefficients of each axis in a band."""
    return 2.0 * band_hz * _length_s(segments)


def _length_s(segments: Sequence[AttitudeSegment]) -> float:
    return sum(segment.track.begin_s.size * segment.track.step_s for segment in segments)


def solve_without_effects(fit: AttitudeFit, effects: Mapping[int, FloatArray]) -> AttitudeFit:
    """Repeat a fit without the effects of causes.

    Args:
        fit: a fit to the same recordings.
        effects: contribution of the causes to the mean rates of segments, (n, 3), by number in
            `fit`; the other segments are left out.
    """
    numbers = sorted(effects)
    segments = [fit.solver.segments[k] for k in numbers]
    recordings = [fit.solver.recording_of_segment[k] for k in numbers]
    known_effects = [effects[k] for k in numbers]
    repeated = _solve_segments(
        segments, recordings, DEFAULT_BAND_HZ, known_effects, fit.resolved, fit.rounding_std_rad_s
    )
    return replace(repeated, shared_noise_reasons=fit.shared_noise_reasons)


def _solve_segments(
    segments: list[AttitudeSegment],
    recording_of_segment: list[int],
    band_hz: float,
    effects: list[FloatArray] | None,
    resolved: tuple[ResolvedReference, ...],
    rounding_std_rad_s: FloatArray,
) -> AttitudeFit:
    _check_length(segments, LOWER_BAND_SHARE * band_hz)
    solver = AttitudeSolver(segments, band_hz, recording_of_segment, effects)
    linearised = solver.run()
    bands = _compare_bands(solver)
    if bands.limited_reasons:
        # The effect of smoothing, or of shared errors, grows with frequency.
        band_hz *= LOWER_BAND_SHARE
        solver = AttitudeSolver(segments, band_hz, recording_of_segment, effects)
        linearised = solver.run()
    lags_s = solver.lags_s[solver.recordings_with_lag(linearised)]
    if np.any(np.abs(lags_s) > 0.999 * LAG_LIMIT_S):
        raise InputError(
            "the times of the gyroscope and of the reference attitudes seem to differ by more than "
            f"{LAG_LIMIT_S:.3g} s, which is the limit of the fit, or their clocks run at different "
            "speeds",
            "compare the times of both at the begin and at the end of the motion, correct one of "
            "them (in an import map a constant difference with `origin_s` under `time`, a speed "
            "with `rate_hz` or in the file), and import again",
        )
    return AttitudeFit(solver, linearised, bands, band_hz, resolved, rounding_std_rad_s)


def _check_length(segments: Sequence[AttitudeSegment], band_hz: float) -> None:
    """Raise an error if a band has too few coefficients for gain, bias and time offset.

    Raises:
        InputError: the recordings are too short.
    """
    if _coefficients(segments, band_hz) < MIN_COEFFICIENTS:
        raise InputError(
            f"the gyroscope's samples and the reference attitudes have only "
            f"{_length_s(segments):.1f} s in "
            "common without a gap, which is too short for a fit",
            "record the board and the attitudes together for at least 10 s",
        )


def _compare_bands(solver: AttitudeSolver) -> _BandComparison:
    """Compare with a fit on a lower band; if the two differ, it is uncertain which one is the gain.

    The comparison detects a smoothed reference, or errors that the reference shares with the gyro
    (the pose of a car: gain.xx 0.4 % at 1 Hz, 4.5 % at 5 Hz, each with 0.5 % by its own residual).
    """
    band_hz = solver.band_hz
    lower = AttitudeSolver(
        solver.segments, LOWER_BAND_SHARE * band_hz, solver.recording_of_segment, solver.effects
    )
    observability = analyse_scaled_observability(lower.run().information(), solver.layout.prior_std)
    std = np.sqrt(
        np.diag(observability.covariance)[:9] + np.diag(observability.unobservable_covariance)[:9]
    )
    change = (lower.gain - solver.gain).ravel()
    worst = int(np.argmax(np.abs(change) / std))
    difference_sigma = float(abs(change[worst]) / std[worst])
    if difference_sigma < MAX_BAND_DIFFERENCE_SIGMA:
        return _BandComparison(1.0, ())
    return _BandComparison(
        difference_sigma,
        (
            f"{PARAMETER_NAMES[worst]} depends on the frequency. The value up to "
            f"{LOWER_BAND_SHARE * band_hz:g} Hz, which is reported, differs from the value up to "
            f"{band_hz:g} Hz by {1e3 * change[worst]:+.1f}e-3, or {difference_sigma:.1f} standard "
            "deviations. All standard deviations are scaled up by that factor. The reference is "
            "smoothed or depends on the gyro; use another reference for gains",
        ),
    )
