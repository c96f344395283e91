"""Fit to a reference motion and its summary: a board on a unit, or at rest.

What to use when: `fit_motion` for one recording of a board, `fit_recordings` for several. The
estimator is `likelihood_fit`.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.fit_summary import BASE_TERMS, FitOutcome, build_gyro_fit
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.gyro_fit import (
    NO_SHARING,
    BoardSharing,
    FitDiagnostics,
    GyroFit,
    RecordingFit,
)
from gyrorig_solver.estimate.initial_guess import solve_shared_gain
from gyrorig_solver.estimate.likelihood_fit import fit_likelihood
from gyrorig_solver.estimate.noise_summary import noise_levels, noise_remarks
from gyrorig_solver.estimate.rest_to_rest import BoardPath, CrossCheck, cross_check
from gyrorig_solver.estimate.series import build_series
from gyrorig_solver.estimate.session_fit import SessionFit
from gyrorig_solver.estimate.trust_region import NotConvergedError
from gyrorig_solver.estimate.uncertainty_widening import (
    largest_reduced_chi2,
    reduced_chi2,
    widen_uncertainty,
)
from gyrorig_solver.model import RecordingContext
from gyrorig_solver.reference import DETENT_VARIANCE, PanTiltReference, ReferenceMotion

# Whitened variance in motion over that at rest; above this limit, the model is inadequate.
MAX_REDUCED_CHI2 = 1.25
HELD_OUT_WINDOW_S = 10.0
PATH_RATE_HZ = 100.0  # sufficient for rotations between rests
MAX_REST_RATE_RAD_S = 1e-4  # after the low-pass, the rate decays below this within 0.1 s
REST_TO_REST_HZ = 0.2  # a move with its rests lasts some seconds
MIN_CROSS_CHECK_P = 1e-4  # of the cross-check: one false alarm in ten thousand
MAX_OUTLIER_SHARE = 1e-3  # of the samples


def fit_motion(
    samples: GyroSamples,
    reference: ReferenceMotion,
    reason_texts: Mapping[str, str],
    warnings: tuple[str, ...] = (),
) -> GyroFit:
    """Fit one recording's samples to its reference motion; see `fit_recordings`."""
    return fit_recordings([(samples, reference)], reason_texts, warnings)


def fit_recordings(
    recordings: Sequence[tuple[GyroSamples, ReferenceMotion]],
    reason_texts: Mapping[str, str],
    warnings: tuple[str, ...] = (),
    fitted_terms: Sequence[FittedTerm] = (),
    contexts: Sequence[RecordingContext | None] = (),
) -> GyroFit:
    """Fit one board's recordings together and summarise the result.

    The gain is common to all recordings. Bias and time offset belong to one recording; the result
    has those of the last one.

    Args:
        recordings: samples of one board and the stage's motion on the samples' time axis, in the
            order of time.
        reason_texts: for each gain column, `bias` and `time_offset`, why it can be unobservable.
        warnings: known anomalies.
        fitted_terms: causes beyond the base model, common to all recordings.
        contexts: facts for these causes, one per recording.

    Raises:
        InputError: no sample has a reference, or the fit did not converge.
    """
    solution = solve_motion(recordings, fitted_terms, contexts)
    return summarize_motion_fit(
        solution, [samples for samples, _ in recordings], reason_texts, warnings
    )


def summarize_motion_fit(
    solution: ConvergedFit,
    samples: Sequence[GyroSamples],
    reason_texts: Mapping[str, str],
    warnings: tuple[str, ...] = (),
    sharing: BoardSharing = NO_SHARING,
) -> GyroFit:
    """Build the `GyroFit` (estimates, covariance, warnings) of a converged fit.

    Args:
        solution: of the recordings of `samples`.
        samples: in the order of time.
        reason_texts: as for `fit_recordings`.
        warnings: known anomalies.
        sharing: properties that the fit shares with other boards.

    Raises:
        NotConvergedError: the fit did not converge, so its values are not a result.
    """
    if not solution.converged:
        raise NotConvergedError(solution.convergence, _remedy_without_convergence(solution))
    chi2 = reduced_chi2(solution)
    solution, chi2_factor = widen_uncertainty(solution)
    warnings = (*warnings, *noise_remarks(solution, chi2_factor))
    rms_before, rms_after = _held_out_rms(solution)
    check = _rest_to_rest_check(solution)
    if check is not None and check.p_value < MIN_CROSS_CHECK_P:
        warnings = (
            *warnings,
            "the rotations between rests differ from the integrated rates by "
            f"{check.largest_sigma:.1f} standard deviations, probably because of a timing error; "
            "check the clocks and the commands",
        )
    if solution.outliers > MAX_OUTLIER_SHARE * sum(
        recording_samples.usable.size for recording_samples in samples
    ):
        warnings = (
            *warnings,
            f"{solution.outliers} samples are outliers, and the fit rejected them",
        )
    outcome = FitOutcome(
        estimate=solution.estimate,
        observability=solution.observability,
        reduced_chi2=chi2,
        outliers=solution.outliers,
        rms_before_rad_s=rms_before,
        rms_after_rad_s=rms_after,
        reference="; ".join(
            dict.fromkeys(
                recording_samples.reference.description for recording_samples in solution.sessions
            )
        ),
        reason_texts=reason_texts,
        terms=(
            *BASE_TERMS,
            "time_offset",
            *dict.fromkeys(fitted_term.term.cause for fitted_term in solution.fitted_terms),
        ),
        warnings=warnings,
        limited_reasons=_limited_reasons(solution),
        diagnostics=_diagnostics(solution),
        chi2_limit=float("inf"),  # reported in `_limited_reasons`
        noise=noise_levels(solution),
        rate_range_rad_s=_rate_range(solution),
        clock_truth="the host's capture clock",
        rest_to_rest=check,
        mean_temperature_degc=_mean_temperature_degc(samples[-1]),
        sharing=sharing,
        names=solution.names,
        prior_std=solution.prior_std,
        fitted_terms=solution.fitted_terms,
        recordings=_recording_fits(solution) if len(samples) > 1 else (),
    )
    return build_gyro_fit(outcome, samples)


def solve_motion(
    recordings: Sequence[tuple[GyroSamples, ReferenceMotion]],
    fitted_terms: Sequence[FittedTerm] = (),
    contexts: Sequence[RecordingContext | None] = (),
) -> ConvergedFit:
    """Fit as in `fit_recordings`, and return the converged fit."""
    contexts_or_none = contexts or [None] * len(recordings)
    sessions = [
        create_session(*recording, context)
        for recording, context in zip(recordings, contexts_or_none, strict=True)
    ]
    return fit_likelihood(sessions, fitted_terms)


def create_session(
    samples: GyroSamples, reference: ReferenceMotion, context: RecordingContext | None
) -> SessionFit:
    """Return one recording's part of a fit, before any estimate.

    Raises:
        InputError: no segment of samples is long enough.
    """
    series, sampling = build_series(samples, reference.common_shift_std_s)
    timestamp_std_s = samples.latency_bounds.std_s if samples.latency_bounds else 0.0
    return SessionFit(series, sampling, reference, timestamp_std_s, context)


def _recording_fits(solution: ConvergedFit) -> tuple[RecordingFit, ...]:
    fits = []
    for session, observability in zip(
        solution.sessions, solution.session_observability, strict=True
    ):
        std = np.sqrt(np.diag(observability.covariance)[9:13])
        offset_observed = observability.is_observable(12)
        fits.append(
            RecordingFit(
                bias_rad_s=session.bias_rad_s,
                bias_std_rad_s=std[:3],
                time_offset_s=session.time_offset_s if offset_observed else float("nan"),
                time_offset_std_s=float(std[3]) if offset_observed else float("nan"),
            )
        )
    return tuple(fits)


def _rate_range(solution: ConvergedFit) -> tuple[float, float]:
    rates = [rate @ solution.gain.T for session in solution.sessions for rate in session.rates]
    return min(float(t.min()) for t in rates), max(float(t.max()) for t in rates)


def _held_out_rms(solution: ConvergedFit) -> tuple[float, float]:
    """Return the rms residual on held-out windows: with the nominal gain, and calibrated.

    Alternating windows of 10 s fit and test. The bias comes from the fitted windows in both cases.
    """
    squares, count = np.zeros(2), 0
    for half in (0, 1):
        train = [[u & (h != half) for u, h in _window_halves(s)] for s in solution.sessions]
        test = [[u & (h == half) for u, h in _window_halves(s)] for s in solution.sessions]
        if min(_count_used(train), _count_used(test)) < 50:
            continue
        sums = [
            s.least_squares_sums(masks) for s, masks in zip(solution.sessions, train, strict=True)
        ]
        for k, gain in enumerate((np.eye(3), solve_shared_gain(sums))):
            for session, session_sums, masks in zip(solution.sessions, sums, test, strict=True):
                squares[k] += session.least_squares_sums(masks).residual_sum_of_squares(
                    gain, session_sums.bias(gain)
                )
        count += 3 * _count_used(test)
    if not count:
        return float("nan"), float("nan")
    before, after = np.sqrt(squares / count)
    return float(before), float(after)


def _window_halves(session: SessionFit) -> list[tuple[BoolArray, IntArray]]:
    """Return per series which blocks are used, and the half of each block."""
    length = max(1, round(HELD_OUT_WINDOW_S * session.sampling.rate_hz))
    return [(used, (np.arange(used.size) // length) % 2) for used in session.used]


def _count_used(masks: Sequence[Sequence[BoolArray]]) -> int:
    return sum(int(mask.sum()) for session in masks for mask in session)


def _rest_to_rest_check(solution: ConvergedFit) -> CrossCheck | None:
    """Compare the fit with the rotations between rests, on a pan-tilt unit.

    The result is None without a unit, and for a long recording, whose means are too coarse.
    """
    paths, variances = [], []
    for session in solution.sessions:
        reference = session.reference
        if not isinstance(reference, PanTiltReference):
            continue
        if session.series[0].has_means and session.sampling.rate_hz < PATH_RATE_HZ:
            return None
        step_rad = float(np.max(np.abs(reference.rad_per_step)))
        variances.append((reference.move_fit.rest_variance + DETENT_VARIANCE) * step_rad**2)
        for series, measured, effect, rate, used in zip(
            session.series,
            session.measured,
            session.cause_effects,
            session.rates,
            session.used,
            strict=True,
        ):
            group_size = max(1, round(session.sampling.rate_hz / PATH_RATE_HZ))
            time_s = (
                _group_means(series.block_times_s()[:, None], group_size)[:, 0]
                - session.time_offset_s
            )
            moving = (
                _group_means(np.linalg.norm(rate, axis=1)[:, None], group_size)[:, 0]
                > MAX_REST_RATE_RAD_S
            )
            own_rate = _group_means(measured - session.bias_rad_s - effect, group_size)
            all_used = _group_means(used[:, None].astype(np.float64), group_size)[:, 0] > 1.0 - 1e-9
            paths.append(
                BoardPath(time_s, own_rate, all_used, moving, reference.angles_rad(time_s))
            )
    if not paths:
        return None
    frequency_hz = np.array([REST_TO_REST_HZ])
    density = max(float(noise.density(frequency_hz).max()) for noise in solution.noises)
    return cross_check(
        paths, solution.gain, np.zeros(3), solution.observability, density, max(variances)
    )


def _group_means(values: FloatArray, group_size: int) -> FloatArray:
    """Return means over groups of rows, without a last incomplete group."""
    groups = values.shape[0] // group_size
    return np.asarray(values[: groups * group_size].reshape(groups, group_size, -1).mean(axis=1))


def _mean_temperature_degc(samples: GyroSamples) -> float | None:
    """Return the mean temperature reading, absolute or not; None without readings."""
    degc = samples.temperature_degc
    if degc is None or not np.isfinite(degc).any():
        return None
    return float(np.nanmean(degc))


def _limited_reasons(solution: ConvergedFit) -> tuple[str, ...]:
    chi2, worst = largest_reduced_chi2(solution)
    if chi2 <= MAX_REDUCED_CHI2:
        return ()
    of_recording = "" if worst is None else f" in recording {worst + 1}"
    return (
        f"the residual variance in motion{of_recording} is {chi2:.2f} times that at rest, so the "
        "model of the rig is incomplete; run `gyrorig explain`",
    )


def _remedy_without_convergence(solution: ConvergedFit) -> str:
    causes = dict.fromkeys(
        fitted_term.term.cause
        for fitted_term in solution.fitted_terms
        if fitted_term.free_indices.size
    )
    if causes:
        return (
            f"leave out one of the causes ({', '.join(causes)}), or run `gyrorig explain` to find "
            "the causes that the recording shows"
        )
    return "run `gyrorig explain` to find the cause that the model of the rig lacks"


def _diagnostics(solution: ConvergedFit) -> FitDiagnostics:
    """Return the arrays for plots, of the last recording."""
    session, spectrum = solution.sessions[-1], solution.spectra[-1]
    used = np.concatenate(session.used)[:, None]
    residual = np.concatenate(session.residuals(solution.gain))
    white = np.concatenate(solution.whitened_residuals()[-len(session.series) :])
    time_s = np.concatenate([s.block_times_s() for s in session.series])
    angles = getattr(session.reference, "angles_rad", None)  # rests and attitudes have no angles
    return FitDiagnostics(
        time_s=time_s,
        rate_rad_s=np.where(used, np.concatenate(session.measured), np.nan),
        reference_rad_s=np.where(used, np.concatenate(session.rates), np.nan),
        residual_rad_s=np.where(used, residual, np.nan),
        whitened=np.where(used, white, np.nan),
        moving=np.concatenate(session.moving),
        frequency_hz=spectrum.frequency_hz,
        spectrum=spectrum.density,
        spectrum_model=spectrum.expected_density(solution.noises[-1]),
        angle_rad=None if angles is None else angles(time_s - session.time_offset_s),
    )
