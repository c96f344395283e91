"""The fit against reference motions, concluded: a board on a unit, or lying still.

What to use when: `fit_motion` for one recording of a board, `fit_joint` for several;
`likelihood` holds the estimator itself.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.estimate.conclusion import TERMS, Evidence, gyro_fit
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import Solution, solve_likelihood
from gyrorig_solver.estimate.rest_to_rest import CrossCheck, Path, cross_check
from gyrorig_solver.estimate.result import FitDiagnostics, GyroFit, NoiseLevels, RecordingFit
from gyrorig_solver.estimate.series import build_series
from gyrorig_solver.estimate.session import SessionFit
from gyrorig_solver.estimate.start import shared_gain
from gyrorig_solver.model.terms.scene import Setting
from gyrorig_solver.reference.motion import ReferenceMotion
from gyrorig_solver.reference.ptu import PtuReference
from gyrorig_solver.reference.rests import DETENT_VARIANCE
from gyrorig_solver.samples import GyroSamples

# Whitened variance while moving over that at rest: above this, motion is not explained.
MOST_FOR_ANGLES = 1 << 20  # blocks, 3 h; pictures are not worth the memory of more
CHI2_LIMIT = 1.25
HELD_OUT_WINDOW_S = 10.0
PATH_HZ = 100.0  # turns from rest to rest need no finer steps
STANDING_RAD_S = 1e-4  # through the low-pass, a rest decays below this within 0.1 s
REST_TO_REST_HZ = 0.2  # a move and its rests last some seconds
DISAGREEMENT_P = 1e-4  # of the second opinion, one in ten thousand by chance
SPIKES_WORTH_A_WORD = 1e-3  # share of the samples


def fit_motion(
    samples: GyroSamples,
    reference: ReferenceMotion,
    words: Mapping[str, str],
    warnings: tuple[str, ...] = (),
) -> GyroFit:
    """Fit one recording's samples against its reference motion; see `fit_joint`."""
    return fit_joint([(samples, reference)], words, warnings)


def fit_joint(
    recordings: Sequence[tuple[GyroSamples, ReferenceMotion]],
    words: Mapping[str, str],
    warnings: tuple[str, ...] = (),
    extensions: Sequence[Extension] = (),
    settings: Sequence[Setting | None] = (),
) -> GyroFit:
    """Fit one board's recordings together and conclude what may be said.

    The gain is common to all, bias and time offset are each recording's own; those of the
    last one are the result's.

    Args:
        recordings: samples of one board and the stage's motion on the samples' time axis,
            in the order of time.
        words: for each gain column, `bias` and `time_offset`, why it may be hidden.
        warnings: what is already known to be odd, in words.
        extensions: causes beyond the base model, common to all recordings.
        settings: what those may look at, one for each recording.

    Raises:
        InputError: no sample has a reference.
    """
    solution = solution_of(recordings, extensions, settings)
    return concluded(solution, [one for one, _ in recordings], words, warnings)


def concluded(
    solution: Solution,
    samples: Sequence[GyroSamples],
    words: Mapping[str, str],
    warnings: tuple[str, ...] = (),
    more: Mapping[str, float] | None = None,
) -> GyroFit:
    """Return what may be said of one board, from where its fit ended.

    Args:
        solution: of the recordings that `samples` are of.
        samples: in the order of time.
        words: as for `fit_joint`.
        warnings: what is already known to be odd, in words.
        more: numbers that are to stand beside the result.
    """
    chi2 = reduced_chi2(solution)
    before, after = _held_out(solution)
    second = _second_opinion(solution)
    if second is not None and second.p_value < DISAGREEMENT_P:
        warnings = (
            *warnings,
            f"the turns from rest to rest disagree with the rates by {second.largest_sigma:.1f} "
            "standard deviations: timing is the suspect; look at clocks and commands",
        )
    if solution.outliers > SPIKES_WORTH_A_WORD * sum(s.good.size for s in samples):
        warnings = (*warnings, f"{solution.outliers} samples were set aside as spikes")
    evidence = Evidence(
        estimate=solution.estimate,
        decision=solution.decision,
        reduced_chi2=chi2,
        outliers=solution.outliers,
        rms_before_rad_s=before,
        rms_after_rad_s=after,
        reference="; ".join(dict.fromkeys(s.reference.description for s in solution.sessions)),
        words=words,
        terms=(*TERMS, "time_offset", *dict.fromkeys(e.term.cause for e in solution.extensions)),
        warnings=warnings,
        distrust=_distrust(solution, chi2),
        diagnostics=_diagnostics(solution),
        chi2_limit=float("inf"),  # said in this reference's own words
        noise=_levels(solution),
        rate_range_rad_s=_range(solution),
        clock_truth="the host's capture clock",
        extra={**_said(second), **_warmth(samples[-1]), **(more or {})},
        names=solution.names,
        unit=solution.unit,
        extensions=solution.extensions,
        recordings=_apart(solution) if len(samples) > 1 else (),
    )
    return gyro_fit(evidence, samples)


def solution_of(
    recordings: Sequence[tuple[GyroSamples, ReferenceMotion]],
    extensions: Sequence[Extension] = (),
    settings: Sequence[Setting | None] = (),
) -> Solution:
    """Fit as `fit_joint` does and return where the fit ended, for what looks on from there."""
    around = settings or [None] * len(recordings)
    sessions = [session_of(*one, where) for one, where in zip(recordings, around, strict=True)]
    return solve_likelihood(sessions, extensions)


def session_of(
    samples: GyroSamples, reference: ReferenceMotion, setting: Setting | None
) -> SessionFit:
    """Return one recording's part of a fit, nothing known yet.

    Raises:
        InputError: no stretch of samples is long enough.
    """
    series, sampling = build_series(samples, reference.common_std_s)
    stamp_std_s = samples.floor.std_s if samples.floor else 0.0
    return SessionFit(series, sampling, reference, stamp_std_s, setting)


def _apart(solution: Solution) -> tuple[RecordingFit, ...]:
    """Return each recording's own bias and time offset."""
    found = []
    for session, decision in zip(solution.sessions, solution.own, strict=True):
        std = np.sqrt(np.diag(decision.covariance)[9:13])
        seen = decision.shows(12)
        found.append(
            RecordingFit(
                bias_rad_s=session.bias_rad_s,
                bias_std_rad_s=std[:3],
                time_offset_s=session.time_offset_s if seen else float("nan"),
                time_offset_std_s=float(std[3]) if seen else float("nan"),
            )
        )
    return tuple(found)


def _range(solution: Solution) -> tuple[float, float]:
    turning = [rate @ solution.gain.T for s in solution.sessions for rate in s.rates]
    return min(float(t.min()) for t in turning), max(float(t.max()) for t in turning)


def reduced_chi2(solution: Solution) -> float:
    """Return the whitened variance while moving over that at rest, all axes."""
    power = np.concatenate([np.sum(w**2, axis=1) for w in solution.whitened()])
    used = np.concatenate(solution.used())
    turning = np.concatenate([m for s in solution.sessions for m in s.moving])
    on, off = used & turning, used & ~turning
    if on.sum() < 100 or off.sum() < 100:
        return float(np.mean(power[used]) / 3.0)
    return float(np.mean(power[on]) / np.mean(power[off]))


def _held_out(solution: Solution) -> tuple[float, float]:
    """Return rms residual on windows not fitted: with the nominal gain, and calibrated.

    Windows of 10 s in turn fit and judge; bias comes from the fitted ones in both cases.
    """
    squares, count = np.zeros(2), 0
    for part in (0, 1):
        train = [[u & (h != part) for u, h in _halves(s)] for s in solution.sessions]
        test = [[u & (h == part) for u, h in _halves(s)] for s in solution.sessions]
        if min(_count(train), _count(test)) < 50:
            continue
        sums = [s.rough(use) for s, use in zip(solution.sessions, train, strict=True)]
        for k, gain in enumerate((np.eye(3), shared_gain(sums))):
            for session, rough, use in zip(solution.sessions, sums, test, strict=True):
                squares[k] += session.rough(use).misfit(gain, rough.bias(gain))
        count += 3 * _count(test)
    if not count:
        return float("nan"), float("nan")
    before, after = np.sqrt(squares / count)
    return float(before), float(after)


def _halves(session: SessionFit) -> list[tuple[BoolArray, IntArray]]:
    """Return for each series which blocks are used, and to which half each belongs."""
    length = max(1, round(HELD_OUT_WINDOW_S * session.sampling.rate_hz))
    return [(used, (np.arange(used.size) // length) % 2) for used in session.used]


def _count(use: Sequence[Sequence[BoolArray]]) -> int:
    return sum(int(some.sum()) for session in use for some in session)


def _second_opinion(solution: Solution) -> CrossCheck | None:
    """Compare the fit with the turns from rest to rest, where a unit made them."""
    paths, variances = [], []
    for session in solution.sessions:
        reference = session.reference
        if not isinstance(reference, PtuReference):
            continue
        step_rad = float(np.max(np.abs(reference.rad_per_step)))
        variances.append((reference.starts.rest_variance + DETENT_VARIANCE) * step_rad**2)
        for series, measured, effect, rate, used in zip(
            session.series,
            session.measured,
            session.effects,
            session.rates,
            session.used,
            strict=True,
        ):
            many = max(1, round(session.sampling.rate_hz / PATH_HZ))
            time_s = _means(series.block_times_s()[:, None], many)[:, 0] - session.time_offset_s
            moving = _means(np.linalg.norm(rate, axis=1)[:, None], many)[:, 0] > STANDING_RAD_S
            own = _means(measured - session.bias_rad_s - effect, many)
            whole = _means(used[:, None].astype(np.float64), many)[:, 0] > 1.0 - 1e-9
            paths.append(Path(time_s, own, whole, moving, reference.angles_rad(time_s)))
    if not paths:
        return None
    at = np.array([REST_TO_REST_HZ])
    density = max(float(noise.density(at).max()) for noise in solution.noises)
    return cross_check(
        paths, solution.gain, np.zeros(3), solution.decision, density, max(variances)
    )


def _means(values: FloatArray, many: int) -> FloatArray:
    """Return means over groups of rows, a last short group left out."""
    groups = values.shape[0] // many
    return np.asarray(values[: groups * many].reshape(groups, many, -1).mean(axis=1))


def _warmth(samples: GyroSamples) -> dict[str, float]:
    """Return the mean of a board's thermometer, whether or not its zero is known."""
    degc = samples.temperature_degc
    if degc is None or not np.isfinite(degc).any():
        return {}
    return {"mean_temperature_degc": float(np.nanmean(degc))}


def _said(second: CrossCheck | None) -> dict[str, float]:
    if second is None:
        return {}
    return {
        "rest_to_rest_moves": float(second.moves),
        "rest_to_rest_p_value": second.p_value,
        "rest_to_rest_largest_sigma": second.largest_sigma,
    }


def _levels(solution: Solution) -> NoiseLevels:
    levels = np.sqrt(solution.noises[-1].levels)
    return NoiseLevels(
        angle_random_walk=levels[:, 0],
        bias_instability=levels[:, 1],
        rate_random_walk=levels[:, 2],
        source=solution.sources[-1],
    )


def _distrust(solution: Solution, chi2: float) -> tuple[str, ...]:
    reasons = []
    if not solution.converged:
        reasons.append(
            "the fit did not settle, so the model of the rig lacks something: `gyrorig explain` "
            "looks for it"
        )
    if chi2 > CHI2_LIMIT:
        reasons.append(
            f"while moving the residual is {chi2:.2f} times the noise at rest: the model of the "
            "rig lacks something; look at the residual over time and angle"
        )
    return tuple(reasons)


def _diagnostics(solution: Solution) -> FitDiagnostics:
    """Return the arrays for pictures, of the last recording."""
    session, spectrum = solution.sessions[-1], solution.spectra[-1]
    used = np.concatenate(session.used)[:, None]
    residual = np.concatenate(session.residuals(solution.gain))
    white = np.concatenate(solution.whitened()[-len(session.series) :])
    time_s = np.concatenate([s.block_times_s() for s in session.series])
    angles = getattr(session.reference, "angles_rad", None)  # rests and attitudes have none
    if time_s.size > MOST_FOR_ANGLES:
        angles = None
    return FitDiagnostics(
        time_s=time_s,
        rate_rad_s=np.where(used, np.concatenate(session.measured), np.nan),
        reference_rad_s=np.where(used, np.concatenate(session.rates), np.nan),
        residual_rad_s=np.where(used, residual, np.nan),
        whitened=np.where(used, white, np.nan),
        moving=np.concatenate(session.moving),
        frequency_hz=spectrum.frequency_hz,
        spectrum=spectrum.density,
        spectrum_model=solution.noises[-1].density(spectrum.frequency_hz),
        angle_rad=None if angles is None else angles(time_s - session.time_offset_s),
    )
