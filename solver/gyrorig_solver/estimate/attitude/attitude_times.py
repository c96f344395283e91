"""Times of reference attitudes, which the gyro decides.

The timestamps give several candidates for the times (`reference.attitude_stamps`). Each candidate
is fitted to the gyro, and the one with the least residual is used. Then outliers and swapped
markers are removed, and the drift between the clocks of reference and gyro is corrected.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.data.stream.stuck_axes import CLIPPING_REMEDY
from gyrorig_solver.estimate.attitude.attitude_conventions import check_convention
from gyrorig_solver.estimate.attitude.attitude_matching import (
    MAX_LAG_S,
    MIN_BLOCKS,
    match_segments,
)
from gyrorig_solver.estimate.attitude.attitude_repair import remove_outliers, remove_swapped
from gyrorig_solver.estimate.attitude.attitude_solver import AttitudeSolver
from gyrorig_solver.estimate.attitude.lag_drift import (
    WINDOW_S,
    LagDrift,
    estimate_drift,
    fit_drift,
)
from gyrorig_solver.estimate.attitude.linearised_model import LinearisedModel
from gyrorig_solver.reference import AttitudeReference
from gyrorig_solver.reference.attitude_reference import DriftCorrection
from gyrorig_solver.reference.attitude_stamps import MIN_STAMPS

# A candidate that is less smooth than the first must be better by this many nats.
MIN_GAIN_NATS = 10.0
MAX_DRIFT_ITERATIONS = 4
MAX_REPAIRS = 3
MAX_NAMED_STEPS = 6
SAME_STEP_S = 2.5 * WINDOW_S  # neighbouring windows can share one step
MIN_NAMED_SKEW = 1e-6
MIN_SCATTER_S = 2e-5  # of the mean timestamp of a window; a smaller drift is irrelevant


@dataclass(frozen=True, slots=True, eq=False)
class ResolvedReference:
    """A reference on the times of the fit, with the results of its repair."""

    reference: AttitudeReference
    remarks: tuple[str, ...] = ()
    outliers: int = 0
    step_std_s: float = 0.0  # uncertainty of the time offset from steps of the clocks
    has_sawtooth: bool = False  # its times have the saw-tooth of a clock
    skew: float = 0.0  # corrected: positive if the clock of the reference was slow

    @property
    def offset_std_s(self) -> float:
        """The uncertainty of the time offset from the timestamps alone, s."""
        stamps = self.reference.stamps
        return float(np.hypot(0.0 if stamps is None else stamps.offset_std_s, self.step_std_s))


@dataclass(frozen=True, slots=True, eq=False)
class _Candidate:
    reference: AttitudeReference
    solver: AttitudeSolver
    log_variance: float  # of all residuals in the band, in nats


def resolve_times(
    samples: GyroSamples, reference: AttitudeReference, band_hz: float, keep_sawtooth: bool = False
) -> ResolvedReference:
    """Return the reference on the times that agree best with the gyro.

    Args:
        samples: of one board, on the time axis of the reference.
        reference: the attitudes as recorded.
        band_hz: higher frequencies are not used.
        keep_sawtooth: leave the saw-tooth of a clock in the times, for a search for causes.

    Raises:
        InputError: gyro and reference hardly overlap, the quaternions have another convention,
            or jitter hides which frames are missing.
    """
    stamps = reference.stamps
    if stamps is not None and not stamps.is_resolved:
        jitter_ms, period_ms = 1e3 * stamps.jitter_s, 1e3 * stamps.period_s
        raise InputError(
            f"the times of the reference attitudes jitter by {jitter_ms:.1f} ms, and the jitter "
            f"hides which frames are missing (one frame is {period_ms:.1f} ms)",
            "record the camera's own times, or avoid lost frames",
        )
    remark = check_convention(samples, reference)
    outliers, remarks = 0, [remark] if remark else []
    best = _best_candidate(samples, reference.alternatives(), band_hz)
    for _ in range(MAX_REPAIRS):
        repaired, found_outliers, jumps = remove_outliers(best.solver, best.reference)
        if not found_outliers and not jumps:
            break
        outliers += found_outliers
        best = _fit_drift(samples, repaired, band_hz, best.solver.lags_s)
    if best.reference.is_cut is not None:
        repaired, text = remove_swapped(best.solver, best.reference)
        if text:
            remarks.append(text)
            best = _fit_drift(samples, repaired, band_hz, best.solver.lags_s)
    has_sawtooth = best.reference.drift is not None and best.reference.drift.has_sawtooth
    keep_sawtooth = keep_sawtooth and has_sawtooth
    resolved = best.reference
    if keep_sawtooth:
        uncorrected = resolved.without_drift_correction()
        resolved = _fit_drift(samples, uncorrected, band_hz, best.solver.lags_s, True).reference
    drift = _stamp_drift(resolved)
    return ResolvedReference(
        resolved,
        (*remarks, *_drift_remarks(drift)),
        outliers,
        drift.step_std_s,
        keep_sawtooth,
        drift.skew,
    )


def _best_candidate(
    samples: GyroSamples, references: list[AttitudeReference], band_hz: float
) -> _Candidate:
    """Return the fit of the smoothest times, or of other times that are clearly better."""
    best = smoothest = _fit_drift(samples, references[0], band_hz)
    correction_s = smoothest.reference.time_s - references[0].time_s
    for reference in references[1:]:
        corrected = replace(
            smoothest.reference,
            time_s=reference.time_s + correction_s,
            even_s=None if reference.even_s is None else reference.even_s + correction_s,
        )
        segments = match_segments(samples, corrected)
        if not segments:
            continue
        solver = AttitudeSolver(segments, band_hz, lags_s=smoothest.solver.lags_s)
        solver.gain, solver.biases = smoothest.solver.gain, smoothest.solver.biases
        if _log_variance(solver.linearise()) < smoothest.log_variance - MIN_GAIN_NATS:
            candidate = _fit_drift(samples, reference, band_hz, smoothest.solver.lags_s)
            if candidate.log_variance < best.log_variance - MIN_GAIN_NATS:
                best = candidate
    return best


def _log_variance(linearised: LinearisedModel) -> float:
    """Return the log of the variances of all residuals in the band, in nats."""
    return 0.5 * float(np.sum(np.log(linearised.variance)))


def no_common_stretch(
    samples: GyroSamples, reference: AttitudeReference, recording: int = 0, recordings: int = 1
) -> InputError:
    """Return the error of a gyro and attitudes without a common stretch of time.

    Args:
        samples: of one board, on the time axis of the reference.
        reference: the attitudes.
        recording: index of the recording.
        recordings: how many are fitted together.
    """
    where = "" if recordings == 1 else f" of recording {recording + 1}"
    begin_s = max(float(samples.time_s[0]), float(reference.time_s[0]))
    end_s = min(float(samples.time_s[-1]), float(reference.time_s[-1]))
    if end_s - begin_s < 2.0 * MAX_LAG_S:
        overlap = (
            f"overlap for only {end_s - begin_s:.2g} s" if end_s > begin_s else "do not overlap"
        )
        return InputError(
            f"the gyroscope's samples and the reference attitudes{where} {overlap} in time",
            "record the board and the attitudes together for at least a few seconds; if you did, "
            "correct the unit of the times (in an import map `unit` under `time`)",
        )
    unusable = int(np.sum(~samples.usable))
    is_clipped = 2 * unusable > samples.usable.size
    left_out = (
        f", because {unusable} of {samples.usable.size} samples are near the end of the sensor's "
        "range or repeat the one before"
    )
    return InputError(
        f"the gyroscope's samples and the reference attitudes{where} overlap for "
        f"{end_s - begin_s:.1f} s, but have gaps: no stretch without a gap contains {MIN_BLOCKS} "
        f"attitudes{left_out if is_clipped else ''}",
        CLIPPING_REMEDY
        if is_clipped
        else "find out why samples or attitudes are missing, and record again",
    )


def _fit_drift(
    samples: GyroSamples,
    reference: AttitudeReference,
    band_hz: float,
    lags_s: FloatArray | None = None,
    keep_sawtooth: bool = False,
) -> _Candidate:
    """Fit one reference, and correct its times until the residual shows no drift.

    With `keep_sawtooth`, only the line and the steps in addition to a saw-tooth are corrected.
    """
    for iteration in range(MAX_DRIFT_ITERATIONS):
        segments = match_segments(samples, reference)
        if not segments:
            raise no_common_stretch(samples, reference)
        solver = AttitudeSolver(segments, band_hz, lags_s=lags_s)
        linearised = solver.run()
        lags_s = solver.lags_s
        drift = estimate_drift(solver)
        if keep_sawtooth:
            drift = replace(drift, sawtooth=None)
        if drift.is_none or iteration == MAX_DRIFT_ITERATIONS - 1:
            break
        reference = _corrected(reference, drift)
    return _Candidate(reference, solver, _log_variance(linearised))


def _corrected(attitudes: AttitudeReference, drift: LagDrift) -> AttitudeReference:
    """Return the reference on corrected times; the mean of the correction is zero."""
    correction_s = drift.at(attitudes.time_s)
    correction_s = correction_s - float(np.mean(correction_s))
    is_step = drift.cuts(attitudes.time_s)
    is_cut = is_step if attitudes.is_cut is None else is_step | attitudes.is_cut
    total = DriftCorrection(correction_s, is_step, drift.sawtooth is not None)
    if attitudes.drift is not None:
        total = DriftCorrection(
            correction_s + attitudes.drift.shift_s,
            is_step | attitudes.drift.is_cut,
            total.has_sawtooth or attitudes.drift.has_sawtooth,
        )
    return replace(
        attitudes,
        time_s=attitudes.time_s + correction_s,
        even_s=None if attitudes.even_s is None else attitudes.even_s + correction_s,
        is_cut=is_cut if is_cut.any() else None,
        drift=total,
    )


def _stamp_drift(attitudes: AttitudeReference) -> LagDrift:
    """Return the drift of the times of the fit relative to the recorded timestamps."""
    stamps = attitudes.stamps
    if stamps is None or stamps.stamp_s.size < MIN_STAMPS:
        return LagDrift(0.0, (), (), 0.0)
    width = max(1, round(WINDOW_S / stamps.period_s))
    starts = np.arange(0, max(stamps.stamp_s.size - width // 2, 1), width)
    counts = np.diff(np.append(starts, stamps.stamp_s.size))
    error_s = attitudes.time_s - stamps.stamp_s
    scatter_s = max(stamps.jitter_s, MIN_SCATTER_S * np.sqrt(width))
    return fit_drift(
        np.add.reduceat(stamps.stamp_s, starts) / counts,
        np.add.reduceat(error_s, starts) / counts,
        counts / scatter_s**2,
    )


def _drift_remarks(drift: LagDrift) -> list[str]:
    remarks = []
    if abs(drift.skew) > MIN_NAMED_SKEW:
        word = "slow" if drift.skew > 0.0 else "fast"
        remarks.append(
            f"the clock of the reference attitudes runs {1e6 * abs(drift.skew):.0f} ppm {word} "
            "relative to the gyro's clock; the solver corrected their times"
        )
    if drift.sawtooth is not None:
        word = "slow" if drift.sawtooth_rate > 0.0 else "fast"
        step_ms = 1e3 * abs(drift.sawtooth_rate) * drift.sawtooth.period_s
        remarks.append(
            f"the clock of the reference attitudes runs {1e6 * abs(drift.sawtooth_rate):.0f} ppm "
            f"{word} relative to the gyro's clock and is set right by {step_ms:.1f} ms every "
            f"{drift.sawtooth.period_s:.1f} s, or the gyro's clock does the opposite; the solver "
            "corrected the times of the attitudes"
        )
    steps: list[tuple[float, float]] = []
    for at_s, size_s in zip(drift.step_time_s, drift.step_s, strict=True):
        if steps and at_s - steps[-1][0] < SAME_STEP_S:
            steps[-1] = steps[-1][0], steps[-1][1] + size_s
        else:
            steps.append((at_s, size_s))
    if steps:
        named = ", ".join(
            f"{1e3 * size_s:+.1f} ms at {at_s:.0f} s" for at_s, size_s in steps[:MAX_NAMED_STEPS]
        )
        more = f" and {len(steps) - MAX_NAMED_STEPS} more" if len(steps) > MAX_NAMED_STEPS else ""
        remarks.append(
            "the clocks of gyro and reference attitudes step relative to each other: "
            f"{named}{more}; the solver corrected the times of the attitudes"
        )
    return remarks
