"""The summary of a fit to reference attitudes: observability, residuals, warnings and plots.

What to use when: `fit_attitude` for one board in one or more recordings with `/reference/attitude`;
`summarize_attitude_fit` for a fit of `attitude_fit`.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.attitude.attitude_fit import (
    DEFAULT_BAND_HZ,
    AttitudeFit,
    solve_attitude,
)
from gyrorig_solver.estimate.attitude.attitude_solver import AttitudeSolver
from gyrorig_solver.estimate.fit_summary import FitOutcome, build_gyro_fit
from gyrorig_solver.estimate.gyro_fit import FitDiagnostics, GyroFit, RecordingFit
from gyrorig_solver.estimate.information import PARAMETER_NAMES, add_parameter_noise
from gyrorig_solver.estimate.observability import (
    ObservabilityAnalysis,
    analyse_observability,
)
from gyrorig_solver.estimate.parameter_layout import eliminate_parameters
from gyrorig_solver.reference import AttitudeReference
from gyrorig_solver.reference.attitude_reference import MAX_MEAN_RATE_TURN_RAD

PLOT_MOTION_RATE_RAD_S = 0.05  # for plots
PLOT_GAP_S = 1.0  # between two recordings
HELD_OUT_WINDOW_S = 10.0
BIASES, TIME_OFFSET = range(9, 12), 12  # in `PARAMETER_NAMES`
_NOT_CONVERGED = (
    "the fit did not converge; check that the board and the attitudes were recorded together with "
    "one clock, or use another recording"
)
REASON_TEXTS = {
    "x": "the board hardly turned about its x axis; turn the board about all three axes",
    "y": "the board hardly turned about its y axis; turn the board about all three axes",
    "z": "the board hardly turned about its z axis; turn the board about all three axes",
    "bias": "the recording has too few samples; record a minute at rest",
    "time_offset": "the rate never changed; start and stop the board several times",
}


def fit_attitude(
    recordings: Sequence[tuple[GyroSamples, AttitudeReference]], band_hz: float = DEFAULT_BAND_HZ
) -> GyroFit:
    """Calibrate one board with reference attitudes.

    Args:
        recordings: samples and attitudes, each pair on one time axis.
        band_hz: higher frequencies are not used.

    Returns:
        The fit; G maps body rate (the reference's body frame) to sensor rate.

    Raises:
        InputError: gyro and reference hardly overlap.
    """
    fit = solve_attitude(recordings, band_hz)
    return summarize_attitude_fit(fit, recordings)


def summarize_attitude_fit(
    fit: AttitudeFit, recordings: Sequence[tuple[GyroSamples, AttitudeReference]]
) -> GyroFit:
    """Return the summary of a fit; see `fit_attitude`."""
    solver = fit.solver
    inflation = solver.score_inflation(fit.linearised)
    observability = _recording_observability(
        fit, inflation, len(solver.biases) - 1, fit.offset_recording
    )
    outcome = build_outcome(fit, recordings, observability, inflation)
    return build_gyro_fit(outcome, [samples for samples, _ in recordings])


def build_outcome(
    fit: AttitudeFit,
    recordings: Sequence[tuple[GyroSamples, AttitudeReference]],
    observability: ObservabilityAnalysis,
    inflation: float,
) -> FitOutcome:
    """Return the outcome of a fit, with the observability of its 13 parameters.

    Args:
        fit: the fit.
        recordings: samples and attitudes, in the order of the fit.
        observability: of G, of the last recording's bias, and of the stated time offset.
        inflation: variance of the scores, relative to that by the noise.
    """
    solver, bands = fit.solver, fit.bands
    rms_before, rms_after = _held_out_rms(solver)
    return FitOutcome(
        estimate=fit.estimate,
        observability=observability,
        reduced_chi2=inflation,
        outliers=fit.linearised.glitches + sum(outcome.outliers for outcome in fit.resolved),
        rms_before_rad_s=rms_before,
        rms_after_rad_s=rms_after,
        reference=(
            f"mean body rate between reference attitudes, frequencies up to {fit.band_hz:g} Hz; "
            "G relates to the reference's body frame"
        ),
        reason_texts=REASON_TEXTS,
        terms=("bias", "scale", "nonorthogonality", "misalignment", "time_offset"),
        warnings=(
            *_warnings([outcome.reference for outcome in fit.resolved]),
            *(remark for outcome in fit.resolved for remark in outcome.remarks),
        ),
        refused_reasons=fit.shared_noise_reasons,
        limited_reasons=(
            *(() if solver.converged else (_NOT_CONVERGED,)),
            *bands.limited_reasons,
        ),
        diagnostics=_diagnostics(solver),
        recordings=_recording_fits(fit, inflation) if len(recordings) > 1 else (),
        reference_clock_skew=max((outcome.skew for outcome in fit.resolved), key=abs, default=0.0),
    )


def widened_observability(fit: AttitudeFit) -> ObservabilityAnalysis:
    """Return the observability of G, the last recording's bias, and the stated time offset."""
    inflation = fit.solver.score_inflation(fit.linearised)
    last = len(fit.solver.biases) - 1
    return _recording_observability(fit, inflation, last, fit.offset_recording)


def _recording_observability(
    fit: AttitudeFit, inflation: float, recording: int, offset_recording: int
) -> ObservabilityAnalysis:
    """Return the observability of G, b of one recording and tau of another, widened."""
    solver, layout = fit.solver, fit.solver.layout
    keep = layout.index(recording, offset_recording=offset_recording)
    information = eliminate_parameters(fit.linearised.information(), keep, layout.prior_std)
    information /= max(1.0, inflation) * fit.bands.std_factor**2
    # The common offset of the times is one more unknown with the derivatives of the time offset
    # and a prior; it is eliminated.
    offset_std_s = fit.resolved[offset_recording].offset_std_s
    information = add_parameter_noise(information, TIME_OFFSET, offset_std_s)
    factors = solver.variance_factors(fit.linearised)[keep] / max(1.0, inflation)
    widening = np.sqrt(np.maximum(factors, 1.0))
    # The error by rounding is constant, so that the noise does not widen it.
    for k, std_rad_s in zip(BIASES, fit.rounding_std_rad_s[recording].tolist(), strict=True):
        information = add_parameter_noise(information, k, std_rad_s / float(widening[k]))
    return analyse_observability(information, PARAMETER_NAMES).widened(widening)


def _recording_fits(fit: AttitudeFit, inflation: float) -> tuple[RecordingFit, ...]:
    fits = []
    for k, (bias, lag_s) in enumerate(zip(fit.solver.biases, fit.solver.lags_s, strict=True)):
        analysis = _recording_observability(fit, inflation, k, k)
        std = np.sqrt(np.diag(analysis.covariance)[9:13])
        is_observed = analysis.is_observable(12)
        fits.append(
            RecordingFit(
                bias_rad_s=bias,
                bias_std_rad_s=std[:3],
                time_offset_s=float(lag_s) if is_observed else float("nan"),
                time_offset_std_s=float(std[3]) if is_observed else float("nan"),
            )
        )
    return tuple(fits)


def _warnings(references: Sequence[AttitudeReference]) -> tuple[str, ...]:
    largest = max(reference.largest_turn_rad() for reference in references)
    if largest < MAX_MEAN_RATE_TURN_RAD:
        return ()
    return (
        f"the board turned by up to {np.degrees(largest):.0f} deg between two reference "
        "attitudes; use a reference with a higher rate to measure the motion between them",
    )


def _held_out_rms(solver: AttitudeSolver) -> tuple[float, float]:
    """Return the rms residual on held-out windows, in the band: nominal, and calibrated.

    Alternating windows of 10 s fit and test. The lag is known in both cases; the bias is fitted.
    """
    designs, targets, folds = [], [], []
    for k, segment in enumerate(solver.segments):
        n = segment.track.begin_s.size
        cleaned = solver.clean_segment(k)
        targets.append(solver.band_limit(k, cleaned.measured - solver.bias_of(k)))
        designs.append(np.column_stack([solver.band_limit(k, cleaned.rate), np.ones(n)]))
        window = max(1, round(HELD_OUT_WINDOW_S / segment.track.step_s))
        folds.append(np.arange(n) // window % 2)
    X, y, fold = np.concatenate(designs), np.concatenate(targets), np.concatenate(folds)
    nominal = np.vstack([np.eye(3), np.zeros(3)])
    ridge = np.diag([1e-6, 1e-6, 1e-6, 0.0])
    before, after = [], []
    for half in (0, 1):
        train, test = fold != half, fold == half
        if not train.any() or not test.any():
            return float("nan"), float("nan")
        gram = X[train].T @ X[train] + ridge
        parameters = np.linalg.solve(gram, X[train].T @ y[train] + ridge @ nominal)
        nominal_with_bias = nominal.copy()
        nominal_with_bias[3] = np.mean(y[train] - X[train, :3], axis=0)
        before.append(y[test] - X[test] @ nominal_with_bias)
        after.append(y[test] - X[test] @ parameters)
    return (
        float(np.sqrt(np.mean(np.concatenate(before) ** 2))),
        float(np.sqrt(np.mean(np.concatenate(after) ** 2))),
    )


def _diagnostics(solver: AttitudeSolver) -> FitDiagnostics:
    """Return the band-limited series for plots; the noise model is the binned density."""
    time_s, measured, reference, residual = [], [], [], []
    shifts_s = _shifts_in_sequence_s(solver)
    for k, segment in enumerate(solver.segments):
        stride = max(1, int(1.0 / (4.0 * solver.band_hz * segment.track.step_s)))
        middle_s = 0.5 * (segment.track.edge_s[:-1] + segment.track.edge_s[1:])
        time_s.append((middle_s + shifts_s[solver.recording_of_segment[k]])[::stride])
        cleaned = solver.clean_segment(k)
        measured.append(solver.band_limit(k, cleaned.measured)[::stride])
        reference.append(solver.band_limit(k, cleaned.rate)[::stride])
        residual.append(solver.band_limit(k, cleaned.residual)[::stride])
    rate, residuals = np.concatenate(reference), np.concatenate(residual)
    spectrum = solver.spectrum()
    return FitDiagnostics(
        time_s=np.concatenate(time_s),
        rate_rad_s=np.concatenate(measured),
        reference_rad_s=rate,
        residual_rad_s=residuals,
        whitened=residuals / (1.4826 * np.median(np.abs(residuals), axis=0) + 1e-30),
        moving=np.linalg.norm(rate, axis=1) > PLOT_MOTION_RATE_RAD_S,
        frequency_hz=spectrum.frequency_hz,
        spectrum=spectrum.density,
        spectrum_model=spectrum.density,
    )


def _shifts_in_sequence_s(solver: AttitudeSolver) -> FloatArray:
    """Return the time shift of each recording with which the recordings follow each other."""
    shifts, end_s = np.zeros(len(solver.biases)), 0.0
    for k in range(len(shifts)):
        tracks = [
            segment.track
            for segment, recording in zip(solver.segments, solver.recording_of_segment, strict=True)
            if recording == k
        ]
        if not tracks:
            continue
        begin_s = min(float(track.begin_s[0]) for track in tracks)
        if k > 0:
            shifts[k] = end_s + PLOT_GAP_S - begin_s
        end_s = shifts[k] + max(float(track.end_s[-1]) for track in tracks)
    return shifts
