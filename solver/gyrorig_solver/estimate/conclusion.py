"""From an estimate and its information to a `GyroFit`, whatever the reference was.

What to use when: `gyro_fit` at the end of `motion`, `attitude`, `turns` and `gravity`;
each of them only adds what is its own.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.clocks.course import clock_course
from gyrorig_solver.columns import KEPT_ROWS
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.observability import BIAS_NAMES, Concluded, Decision, conclude
from gyrorig_solver.estimate.result import (
    Clock,
    FitDiagnostics,
    FittedCause,
    GyroFit,
    NoiseLevels,
    RecordingFit,
)
from gyrorig_solver.model.gain import GAIN_NAMES
from gyrorig_solver.model.terms.bound import label
from gyrorig_solver.samples import GyroSamples, mean_degc

NAMES = (*GAIN_NAMES, *BIAS_NAMES, "time_offset")
TERMS = ("bias", "scale", "nonorthogonality", "misalignment")
LIMITED_CHI2 = 1.25
THERMAL = ("thermal_bias", "thermal_scale")  # they count from a temperature
SKEW_WORTH_A_WORD_PPM = 500.0  # a crystal keeps 50; a sensor's own oscillator does not


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What an estimator found, before it is decided what may be said."""

    estimate: (
        FloatArray  # (13 + causes,), in the order of `names`; unobserved directions at nominal
    )
    decision: Decision
    reduced_chi2: float  # nan where nothing in the data checks the noise model
    outliers: int
    rms_before_rad_s: float
    rms_after_rad_s: float
    reference: str
    words: Mapping[str, str]  # why a gain column, the bias or the offset may be hidden
    terms: tuple[str, ...] = TERMS
    warnings: tuple[str, ...] = ()
    distrust: tuple[str, ...] = ()
    diagnostics: FitDiagnostics | None = None
    extra: Mapping[str, float] | None = None
    chi2_limit: float = LIMITED_CHI2  # above it the noise model is not believed
    noise: NoiseLevels | None = None
    rate_range_rad_s: tuple[float, float] | None = None  # None: of all samples
    clock_truth: str = "the recording's own times"
    names: tuple[str, ...] = NAMES  # of the estimate; causes' values may follow the base's
    unit: FloatArray | None = None  # prior deviation of each name, where there are causes
    extensions: tuple[Extension, ...] = ()
    recordings: tuple[RecordingFit, ...] = ()


def gyro_fit(evidence: Evidence, samples: Sequence[GyroSamples]) -> GyroFit:
    """Return the result of one board from one or more recordings.

    Args:
        evidence: what the estimator found.
        samples: of that board, in the order of the recordings.
    """
    found = conclude(
        evidence.estimate, evidence.names, evidence.decision, evidence.words, evidence.unit
    )
    reasons = list(evidence.distrust)
    if evidence.reduced_chi2 > evidence.chi2_limit:
        reasons.append(
            f"the residual is {evidence.reduced_chi2:.2f} times what its noise model says, and the "
            "standard deviations are widened by that; look at the residual over time"
        )
    reasons += [f"not identified: {text}" for text in found.observability.reasons]
    return GyroFit(
        method="likelihood",
        terms=evidence.terms,
        gain=found.gain,
        gain_std=found.gain_std,
        bias_rad_s=found.triple("bias"),
        scale=found.triple("scale"),
        nonorthogonality=found.triple("nonorthogonality"),
        misalignment_rad=found.triple("misalignment"),
        time_offset_s=found.values["time_offset"],
        std=found.std,
        order=found.order,
        covariance=found.covariance,
        observability=found.observability,
        noise=evidence.noise,
        reduced_chi2=evidence.reduced_chi2,
        samples=sum(s.good.size for s in samples),
        lost=sum(s.lost for s in samples),
        outliers=evidence.outliers,
        rate_range_rad_s=evidence.rate_range_rad_s or _rates(samples),
        rms_before_rad_s=evidence.rms_before_rad_s,
        rms_after_rad_s=evidence.rms_after_rad_s,
        temperature_range_degc=_temperatures(samples),
        clock=_clock(samples[0], evidence.clock_truth),
        reference=evidence.reference,
        warnings=(*evidence.warnings, *_sample_warnings(samples)),
        distrust=tuple(reasons),
        diagnostics=evidence.diagnostics,
        extra=dict(evidence.extra or {}),
        causes=(
            *(c for one in evidence.extensions for c in _causes(one, found)),
            *_references(evidence.extensions, samples),
        ),
        recordings=evidence.recordings,
    )


def _causes(one: Extension, found: Concluded) -> Iterator[FittedCause]:
    """Yield the parameters of one fitted cause.

    What was held has its value and no deviation, and none at all where it is as it began.
    """
    free, at = set(one.free.tolist()), 0
    if not free:
        return
    sizes = [p for p in one.term.parameters if p.role == "size"]
    for parameter in one.term.parameters:
        here = range(at, at + parameter.count)
        at += parameter.count
        if free.isdisjoint(here) and np.all(
            one.values[at - parameter.count : at] == parameter.start
        ):
            continue
        cause = label(one.term)
        names = [f"{cause}.{name}" for name in parameter.names]
        held = dict(zip(names, one.values[here.start : here.stop], strict=True))
        alone = len(sizes) == 1 and parameter.role == "size"
        yield FittedCause(
            name=cause if alone else f"{cause}.{parameter.name}",
            value=np.array([found.values.get(name, held[name]) for name in names]),
            std=np.array([found.std.get(name, np.nan) for name in names]),
            unit=parameter.unit,
        )


def _references(
    extensions: Sequence[Extension], samples: Sequence[GyroSamples]
) -> Iterator[FittedCause]:
    """Yield what the temperatures of thermal causes count from: who applies them needs it."""
    thermal = dict.fromkeys(
        label(one.term) for one in extensions if one.free.size and one.term.cause in THERMAL
    )
    mean = mean_degc(samples) if thermal else None
    if mean is None:
        return
    for cause in thermal:
        yield FittedCause(f"{cause}.reference", np.array([mean]), np.zeros(1), "degC")


def _rates(samples: Sequence[GyroSamples]) -> tuple[float, float]:
    good = [s.rate_rad_s[s.good] for s in samples]
    return float(min(r.min() for r in good)), float(max(r.max() for r in good))


def _temperatures(samples: Sequence[GyroSamples]) -> tuple[float, float] | None:
    known = [s for s in samples if s.absolute_degc]
    there = [s.temperature_degc for s in known if s.temperature_degc is not None]
    if not there:
        return None
    return float(min(np.nanmin(t) for t in there)), float(max(np.nanmax(t) for t in there))


def _clock(samples: GyroSamples, truth: str) -> Clock:
    short = samples.number.size <= KEPT_ROWS  # arrivals of a longer one are read once more
    return Clock(
        skew_ppm=samples.clock.skew_ppm,
        wander_bound_s=samples.clock.wander_bound_s,
        latency_median_s=float(samples.clock.latency_s[0]),
        latency_max_s=float(samples.clock.latency_s[2]),
        restarts=samples.clock.restarts,
        wraps=samples.clock.wraps,
        truth=truth,
        course=(
            clock_course(samples.time_s, samples.host_s, samples.number, samples.segment)
            if short
            else None
        ),
    )


def _skew_text(skew_ppm: float) -> str:
    """Say which clock is believed, and what the other would make of the gain."""
    way = "larger" if skew_ppm > 0.0 else "smaller"
    return (
        f"the board's clock differs from the host's by {skew_ppm:+.0f} ppm; the host's is taken "
        "as the truth: were the board's right, every scale would be "
        f"{abs(skew_ppm) * 1e-4:.2f} % {way}"
    )


_STRUCTURED = "sample times may err by as much; pings of the board would tell"


def _sample_warnings(samples: Sequence[GyroSamples]) -> list[str]:
    repeated = sum(s.repeated for s in samples)
    counts = (
        (sum(s.lost for s in samples), "samples are missing by the board's own counter"),
        (repeated, "samples are repeats of one before and were not used"),
        (
            sum(int(np.sum(~s.good)) for s in samples) - repeated,
            "samples are saturated and were not used; use a larger full scale or lower rates",
        ),
        (sum(s.late for s in samples), "samples came after a younger one"),
        (sum(s.clock.restarts for s in samples), "times the board's clock began anew"),
        (sum(s.clock.steps for s in samples), "times the board's clock or the host's jumped"),
    )
    skews = [s.clock.skew_ppm for s in samples if abs(s.clock.skew_ppm) > SKEW_WORTH_A_WORD_PPM]
    structured = {s.clock.structured for s in samples if s.clock.structured}
    return [
        *(f"{count} {text}" for count, text in counts if count > 0),
        *(_skew_text(max(skews, key=abs)) for _ in skews[:1]),
        *(f"structured latency: {text}; {_STRUCTURED}" for text in sorted(structured)),
    ]
