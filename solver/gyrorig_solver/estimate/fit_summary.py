"""The summary of an estimate as a `GyroFit`, for every kind of reference.

What to use when: `build_gyro_fit` at the end of `motion_fit`, `attitude_summary`, `turn_fit` and
`gravity_fit`, each of which adds only its specific data.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.clocks.clock_trace import trace_clock
from gyrorig_solver.data.count_columns import MAX_CACHED_ROWS
from gyrorig_solver.data.samples import GyroSamples, mean_temperature_degc
from gyrorig_solver.estimate.derived_parameters import DerivedParameters, derive_parameters
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.gyro_fit import (
    NO_SHARING,
    BoardSharing,
    ClockQuality,
    FitDiagnostics,
    FittedParameter,
    GravityMoves,
    GyroFit,
    NoiseLevels,
    RecordingFit,
)
from gyrorig_solver.estimate.information import PARAMETER_NAMES
from gyrorig_solver.estimate.observability import ObservabilityAnalysis
from gyrorig_solver.estimate.rest_to_rest import CrossCheck
from gyrorig_solver.model import term_label

BASE_TERMS = ("bias", "scale", "nonorthogonality", "misalignment")
MAX_REDUCED_CHI2_LIMITED = 1.25
# Closer rates mean the same clock: rounding to 1e-9 s in 10 s is a tenth of it.
SAME_CLOCK_PPM = 1e-3
MAX_USUAL_SKEW_PPM = 500.0  # a crystal has 50; a sensor's oscillator has more


@dataclass(frozen=True, slots=True, eq=False)
class FitOutcome:
    """The result of an estimator, before observability is applied."""

    estimate: (
        FloatArray  # (13 + causes,), in the order of `names`; unobserved directions at nominal
    )
    observability: ObservabilityAnalysis
    reduced_chi2: float  # nan if the data cannot test the noise model
    outliers: int
    rms_before_rad_s: float
    rms_after_rad_s: float
    reference: str
    reason_texts: Mapping[str, str]  # of a gain column, the bias or the offset, if unobservable
    terms: tuple[str, ...] = BASE_TERMS
    warnings: tuple[str, ...] = ()
    refused_reasons: tuple[str, ...] = ()
    limited_reasons: tuple[str, ...] = ()
    diagnostics: FitDiagnostics | None = None
    rest_to_rest: CrossCheck | None = None
    mean_temperature_degc: float | None = None
    sharing: BoardSharing = NO_SHARING
    gravity_moves: GravityMoves | None = None
    chi2_limit: float = MAX_REDUCED_CHI2_LIMITED  # with a larger value, the noise model is rejected
    noise: NoiseLevels | None = None
    rate_range_rad_s: tuple[float, float] | None = None  # None: of all samples
    clock_truth: str = "the recording's own times"
    names: tuple[str, ...] = PARAMETER_NAMES  # of the estimate; values of causes can follow
    prior_std: FloatArray | None = None  # of each name, if there are causes
    fitted_terms: tuple[FittedTerm, ...] = ()
    recordings: tuple[RecordingFit, ...] = ()
    reference_clock_skew: float = 0.0


def build_gyro_fit(outcome: FitOutcome, samples: Sequence[GyroSamples]) -> GyroFit:
    """Return the result of one board from one or more recordings.

    Args:
        outcome: of the estimator.
        samples: of that board, in the order of the recordings.
    """
    derived = derive_parameters(
        outcome.estimate,
        outcome.names,
        outcome.observability,
        outcome.reason_texts,
        outcome.prior_std,
    )
    reasons = list(outcome.limited_reasons)
    if outcome.reduced_chi2 > outcome.chi2_limit:
        reasons.append(
            f"the residual variance is {outcome.reduced_chi2:.2f} times that of the noise model, "
            "so the solver increased the standard uncertainties; check the residual over time in "
            "the report"
        )
    reasons += [f"not identified: {text}" for text in derived.observability.reasons]
    return GyroFit(
        method="likelihood",
        terms=outcome.terms,
        gain=derived.gain,
        gain_std=derived.gain_std,
        bias_rad_s=derived.values_of_group("bias"),
        scale=derived.values_of_group("scale"),
        nonorthogonality=derived.values_of_group("nonorthogonality"),
        misalignment_rad=derived.values_of_group("misalignment"),
        time_offset_s=derived.values["time_offset"],
        std=derived.std,
        order=derived.order,
        covariance=derived.covariance,
        observability=derived.observability,
        noise=outcome.noise,
        reduced_chi2=outcome.reduced_chi2,
        samples=sum(recording_samples.usable.size for recording_samples in samples),
        lost=sum(recording_samples.lost for recording_samples in samples),
        link=max(samples, key=lambda recording_samples: recording_samples.lost).link,
        outliers=outcome.outliers,
        rate_range_rad_s=outcome.rate_range_rad_s or _rate_range(samples),
        rms_before_rad_s=outcome.rms_before_rad_s,
        rms_after_rad_s=outcome.rms_after_rad_s,
        temperature_range_degc=_temperature_range(samples),
        clock=_clock_quality(samples[0], outcome.clock_truth),
        reference=outcome.reference,
        warnings=(*outcome.warnings, *_sample_warnings(samples)),
        refused_reasons=outcome.refused_reasons,
        limited_reasons=tuple(reasons),
        diagnostics=outcome.diagnostics,
        rest_to_rest=outcome.rest_to_rest,
        mean_temperature_degc=outcome.mean_temperature_degc,
        sharing=outcome.sharing,
        gravity_moves=outcome.gravity_moves,
        causes=(
            *(
                parameter
                for fitted_term in outcome.fitted_terms
                for parameter in fitted_parameters(fitted_term, derived)
            ),
            *_reference_temperatures(outcome.fitted_terms, samples),
        ),
        recordings=outcome.recordings,
        reference_clock_skew=outcome.reference_clock_skew,
    )


def warn_of_unchecked_times(samples: Sequence[GyroSamples]) -> tuple[str, ...]:
    """Return a remark for a reference without times, if only a file states those of the samples.

    The host of a rig checks the clock of a board. A file with one column of times has one clock for
    both, and its times can be nominal.
    """
    has_one_clock = [
        each.is_imported and abs(each.clock.skew_ppm) < SAME_CLOCK_PPM for each in samples
    ]
    if not any(has_one_clock):
        return ()
    return (
        "the reference has no times, so the scale factors are only as accurate as the times in the "
        "file: if these run 1 % fast, the scale factors are 1 % too large. If they are nominal, "
        "compare the duration of the file with a clock, and correct the rate in the import map",
    )


def fitted_parameters(
    fitted_term: FittedTerm, derived: DerivedParameters
) -> Iterator[FittedParameter]:
    """Yield the parameters of one fitted cause.

    Args:
        fitted_term: of the fit.
        derived: values and standard deviations of the fit's parameters.

    A fixed value has no standard deviation. A fixed value at its start is left out.
    """
    free_indices, position = set(fitted_term.free_indices.tolist()), 0
    if not free_indices:
        return
    sizes = [size for size in fitted_term.term.parameters if size.role == "size"]
    for parameter in fitted_term.term.parameters:
        indices = range(position, position + parameter.value_count)
        position += parameter.value_count
        if free_indices.isdisjoint(indices) and np.all(
            fitted_term.values[position - parameter.value_count : position] == parameter.start
        ):
            continue
        cause = term_label(fitted_term.term)
        names = [f"{cause}.{name}" for name in parameter.value_names]
        fixed_values = dict(
            zip(names, fitted_term.values[indices.start : indices.stop], strict=True)
        )
        is_only_size = len(sizes) == 1 and parameter.role == "size"
        yield FittedParameter(
            name=cause if is_only_size else f"{cause}.{parameter.name}",
            value=np.array([derived.values.get(name, fixed_values[name]) for name in names]),
            std=np.array([derived.std.get(name, np.nan) for name in names]),
            unit=parameter.unit,
        )


def _reference_temperatures(
    fitted_terms: Sequence[FittedTerm], samples: Sequence[GyroSamples]
) -> Iterator[FittedParameter]:
    """Yield the reference temperatures of thermal causes, which `gyrorig apply` needs."""
    labels = dict.fromkeys(
        term_label(fitted_term.term)
        for fitted_term in fitted_terms
        if fitted_term.free_indices.size and fitted_term.term.depends_on_temperature
    )
    mean_temperature = mean_temperature_degc(samples) if labels else None
    if mean_temperature is None:
        return
    for cause in labels:
        yield FittedParameter(
            f"{cause}.reference", np.array([mean_temperature]), np.zeros(1), "degC"
        )


def _rate_range(samples: Sequence[GyroSamples]) -> tuple[float, float]:
    good = [recording_samples.rate_rad_s[recording_samples.usable] for recording_samples in samples]
    return float(min(r.min() for r in good)), float(max(r.max() for r in good))


def _temperature_range(samples: Sequence[GyroSamples]) -> tuple[float, float] | None:
    with_absolute = [
        recording_samples
        for recording_samples in samples
        if recording_samples.has_absolute_temperature
    ]
    temperatures = [
        recording_samples.temperature_degc
        for recording_samples in with_absolute
        if recording_samples.temperature_degc is not None
    ]
    if not temperatures:
        return None
    return float(min(np.nanmin(t) for t in temperatures)), float(
        max(np.nanmax(t) for t in temperatures)
    )


def _clock_quality(samples: GyroSamples, reference_clock: str) -> ClockQuality:
    keeps_rows = (
        samples.number.size <= MAX_CACHED_ROWS
    )  # the arrival times of a longer recording are read again
    return ClockQuality(
        skew_ppm=samples.clock.skew_ppm,
        wander_bound_s=samples.clock.wander_bound_s,
        latency_median_s=float(samples.clock.latency_s[0]),
        latency_max_s=float(samples.clock.latency_s[2]),
        restarts=samples.clock.restarts,
        wraps=samples.clock.wraps,
        truth=reference_clock,
        course=(
            trace_clock(samples.time_s, samples.host_s, samples.number, samples.segment)
            if keeps_rows
            else None
        ),
    )


def _skew_text(skew_ppm: float) -> str:
    """Describe which clock is used, and the effect of the other clock on the scale factors."""
    direction = "larger" if skew_ppm > 0.0 else "smaller"
    return (
        "the frequency of the board's clock differs from that of the host's clock by "
        f"{skew_ppm:+.0f} ppm. The solver uses the host's clock; with the board's clock, every "
        f"scale factor would be {abs(skew_ppm) * 1e-4:.2f} % {direction}"
    )


_STRUCTURED_LATENCY = (
    "the sampling times can have the same error. Pings of the board would show this error"
)


def _sample_warnings(samples: Sequence[GyroSamples]) -> list[str]:
    repeated = sum(recording_samples.repeated for recording_samples in samples)
    counts = (
        (
            sum(recording_samples.lost for recording_samples in samples),
            "samples are missing, as the board's counter shows",
        ),
        (repeated, "samples repeat the previous sample, and the solver did not use them"),
        (
            sum(int(np.sum(~recording_samples.usable)) for recording_samples in samples) - repeated,
            "samples are saturated or near saturated ones, and the solver did not use them; set "
            "a larger full scale or turn more slowly",
        ),
        (
            sum(recording_samples.late for recording_samples in samples),
            "samples arrived out of order",
        ),
        (
            sum(recording_samples.clock.restarts for recording_samples in samples),
            "resets of the board's clock occurred",
        ),
        (
            sum(recording_samples.clock.steps for recording_samples in samples),
            "steps of the board's clock or the host's clock occurred",
        ),
    )
    skews = [
        recording_samples.clock.skew_ppm
        for recording_samples in samples
        if abs(recording_samples.clock.skew_ppm) > MAX_USUAL_SKEW_PPM
    ]
    structured = {
        recording_samples.clock.structure_reason
        for recording_samples in samples
        if recording_samples.clock.structure_reason
    }
    return [
        *(f"{count} {text}" for count, text in counts if count > 0),
        *(_skew_text(max(skews, key=abs)) for _ in skews[:1]),
        *(
            f"the latency of the samples is not pure jitter: {text}, and {_STRUCTURED_LATENCY}"
            for text in sorted(structured)
        ),
    ]
