"""From a recording to a fit: choose the reference, solve, conclude.

What to use when: `solve_recordings` is the whole way for one board;
`solve_samples` fits samples against a reference that the caller made.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.estimate.attitude import fit_attitude
from gyrorig_solver.estimate.gravity import fit_gravity
from gyrorig_solver.estimate.likelihood import MOVING_RAD_S, NAMES, Solution, solve_likelihood
from gyrorig_solver.estimate.observability import Concluded, conclude
from gyrorig_solver.estimate.result import Clock, FitDiagnostics, GyroFit, NoiseLevels
from gyrorig_solver.estimate.series import Series, build_series
from gyrorig_solver.estimate.turns import fit_turns
from gyrorig_solver.reference.attitude import AttitudeReference, read_attitude
from gyrorig_solver.reference.motion import ReferenceMotion
from gyrorig_solver.reference.ptu import PtuReference
from gyrorig_solver.reference.ptu_recording import ptu_reference
from gyrorig_solver.reference.rest import RestReference, mostly_at_rest
from gyrorig_solver.reference.turns import TurnReference, read_turns
from gyrorig_solver.samples import GyroSamples, load_samples, number

PTU_WORDS = {
    "x": "tilt was not moved; move tilt at a few speeds",
    "y": "pan was swept at one tilt only, or not at all; sweep it at +T and at -T",
    "z": "pan was not moved, or at one steep tilt only; sweep it at +T and at -T",
    "bias": "there are too few samples; record at rest for a minute",
    "time_offset": "nothing was accelerated; move and stop a few times",
}
REST_WORDS = {
    "x": "the board lay still; turn it about all three axes by a reference",
    "y": "the board lay still; turn it about all three axes by a reference",
    "z": "the board lay still; turn it about all three axes by a reference",
    "bias": "there are too few samples; record at rest for a minute",
    "time_offset": "nothing moved; use a moving reference",
}
STANDARD_GRAVITY_M_S2 = 9.80665  # CGPM 1901; only the accelerometer's scale rests on it
# Whitened variance while moving over that at rest: above this, motion is not explained.
CHI2_LIMIT = 1.25
HELD_OUT_WINDOW_S = 10.0


def solve_recordings(recordings: Sequence[Recording], board: str) -> GyroFit:
    """Calibrate one board by the best reference that its recordings hold.

    In this order: a pan-tilt unit's motion, reference attitudes, turns by known angles,
    rest, gravity between rests. Attitudes and turns may be spread over several recordings.

    Raises:
        InputError: the board is not there, or there is no reference of any kind.
        UsageError: several recordings of a unit's motion at once.
    """
    loaded = [(recording, load_samples(recording, board)) for recording in recordings]
    if any("/ptu/position" in r.topics for r in recordings):
        if len(recordings) > 1:
            raise UsageError(
                f"{len(recordings)} recordings of a pan-tilt unit at once",
                "solve them one at a time; each makes a version",
            )
        recording, samples = loaded[0]
        reference = ptu_reference(recording, samples.origin_ns)
        return solve_samples(samples, reference, PTU_WORDS, _ptu_warnings(reference))
    attitudes = [(s, _attitude(r, s)) for r, s in loaded if "/reference/attitude" in r.topics]
    if attitudes:
        return fit_attitude(attitudes)
    turns = [(s, read_turns(r.events(), s.origin_ns)) for r, s in loaded]
    if any(found.turns for _, found in turns):
        return fit_turns(turns)
    return _by_gravity(loaded, turns)


def _attitude(recording: Recording, samples: GyroSamples) -> AttitudeReference:
    raw = recording.reference_attitude()
    time_s = np.asarray((times_ns(raw["host_time"]) - samples.origin_ns) * 1e-9, np.float64)
    return read_attitude(time_s, raw["orientation"], raw["standard_deviation"])


def _by_gravity(
    loaded: list[tuple[Recording, GyroSamples]], turns: list[tuple[GyroSamples, TurnReference]]
) -> GyroFit:
    if len(loaded) > 1:
        raise UsageError(
            f"{len(loaded)} recordings without a reference of their own at once",
            "solve them one at a time; each makes a version",
        )
    (recording, samples), (_, found) = loaded[0], turns[0]
    if mostly_at_rest(found.rests, float(samples.time_s[-1] - samples.time_s[0])):
        return solve_samples(samples, RestReference(found.rests), REST_WORDS)
    if samples.accel_m_s2 is None:
        raise InputError(
            f"{recording.path.name} holds no reference",
            "give it positions of a unit, attitudes, known turns, or an accelerometer",
        )
    site = recording.metadata.get("gyrorig.site", {})
    gravity = number(site, "gravity_m_s2") or STANDARD_GRAVITY_M_S2
    return fit_gravity(samples, gravity, found.rests[0] if found.rests else None)


def solve_samples(
    samples: GyroSamples,
    reference: ReferenceMotion,
    words: dict[str, str],
    warnings: tuple[str, ...] = (),
) -> GyroFit:
    """Fit samples against a reference motion and conclude what may be said.

    Args:
        samples: of one board.
        reference: the stage's motion, times on the samples' axis.
        words: for each gain column, `bias` and `time_offset`, why it may be hidden.
        warnings: what is already known to be odd, in words.
    """
    series, sampling = build_series(samples)
    stamp_std_s = samples.floor.std_s if samples.floor else 0.0
    solution = solve_likelihood(series, sampling, reference, stamp_std_s)
    concluded = conclude(solution.estimate, NAMES, solution.decision, words)
    moving = [np.linalg.norm(m.rate, axis=1) > MOVING_RAD_S for m in solution.models]
    chi2 = _reduced_chi2(solution, moving)
    before, after = _held_out(solution)
    turning = np.concatenate([m.rate @ solution.gain.T for m in solution.models])
    return GyroFit(
        method="likelihood",
        terms=("bias", "scale", "nonorthogonality", "misalignment", "time_offset"),
        gain=concluded.gain,
        gain_std=concluded.gain_std,
        bias_rad_s=concluded.triple("bias"),
        scale=concluded.triple("scale"),
        nonorthogonality=concluded.triple("nonorthogonality"),
        misalignment_rad=concluded.triple("misalignment"),
        time_offset_s=concluded.values["time_offset"],
        std=concluded.std,
        order=concluded.order,
        covariance=concluded.covariance,
        observability=concluded.observability,
        noise=_levels(solution),
        reduced_chi2=chi2,
        samples=int(samples.good.size),
        lost=samples.lost,
        outliers=solution.outliers,
        rate_range_rad_s=(float(turning.min()), float(turning.max())),
        rms_before_rad_s=before,
        rms_after_rad_s=after,
        temperature_range_degc=_range(samples.temperature_degc),
        clock=_clock(samples),
        reference=reference.description,
        warnings=(*warnings, *_sample_warnings(samples, solution)),
        distrust=_distrust(solution, concluded, chi2),
        diagnostics=_diagnostics(solution, series, moving),
    )


def _reduced_chi2(solution: Solution, moving: list[BoolArray]) -> float:
    """Return the whitened variance while moving over that at rest, all axes."""
    white = np.concatenate(solution.whitened)
    used = np.concatenate([m.used for m in solution.models])
    turning = np.concatenate(moving)
    on, off = used & turning, used & ~turning
    if on.sum() < 100 or off.sum() < 100:
        return float(np.mean(white[used] ** 2))
    return float(np.mean(white[on] ** 2) / np.mean(white[off] ** 2))


def _held_out(solution: Solution) -> tuple[float, float]:
    """Return rms residual on windows not fitted: with the nominal gain, and calibrated.

    Windows of 10 s in turn fit and judge; bias comes from the fitted ones in both cases.
    """
    rate_hz = solution.noise.sampling.rate_hz
    length = max(1, round(HELD_OUT_WINDOW_S * rate_hz))
    design, measured, fold = [], [], []
    for model in solution.models:
        keep = model.used
        design.append(np.column_stack([model.rate, np.ones(keep.size)])[keep])
        measured.append(model.measured[keep])
        fold.append((np.arange(keep.size)[keep] // length) % 2)
    X, y, half = np.concatenate(design), np.concatenate(measured), np.concatenate(fold)
    ridge = np.diag([1e-6, 1e-6, 1e-6, 0.0])
    before, after = [], []
    for part in (0, 1):
        train, test = half != part, half == part
        if train.sum() < 50 or test.sum() < 50:
            continue
        prior = np.vstack([np.eye(3), np.zeros((1, 3))])
        gram = X[train].T @ X[train] + ridge
        found = np.linalg.solve(gram, X[train].T @ y[train] + ridge @ prior)
        nominal = prior.copy()
        nominal[3] = np.mean(y[train] - X[train, :3], axis=0)
        before.append(y[test] - X[test] @ nominal)
        after.append(y[test] - X[test] @ found)
    if not before:
        return float("nan"), float("nan")
    return (
        float(np.sqrt(np.mean(np.concatenate(before) ** 2))),
        float(np.sqrt(np.mean(np.concatenate(after) ** 2))),
    )


def _levels(solution: Solution) -> NoiseLevels:
    levels = np.sqrt(solution.noise.levels)
    return NoiseLevels(
        angle_random_walk=levels[:, 0],
        bias_instability=levels[:, 1],
        rate_random_walk=levels[:, 2],
        source="spectrum of the residual, whole recording",
    )


def _range(values: FloatArray | None) -> tuple[float, float] | None:
    return None if values is None else (float(values.min()), float(values.max()))


def _clock(samples: GyroSamples) -> Clock:
    return Clock(
        skew_ppm=samples.clock.skew_ppm,
        wander_bound_s=samples.clock.wander_bound_s,
        latency_median_s=float(samples.clock.latency_s[0]),
        latency_max_s=float(samples.clock.latency_s[2]),
        restarts=samples.clock.restarts,
        wraps=samples.clock.wraps,
        truth="the host's capture clock",
    )


def _ptu_warnings(reference: PtuReference) -> tuple[str, ...]:
    said = [f"motion unknown for a while: {why}" for _, _, why in reference.motion.unknown]
    if not reference.starts.explained:
        said.append("the polled positions do not follow the commands; check for lost steps")
    return tuple(dict.fromkeys(said))


def _sample_warnings(samples: GyroSamples, solution: Solution) -> tuple[str, ...]:
    said = []
    if samples.lost:
        said.append(f"{samples.lost} samples are missing by the board's own counter")
    if samples.repeated:
        said.append(f"{samples.repeated} samples are repeats of the one before")
    if samples.clock.restarts:
        said.append(f"the board's clock began anew {samples.clock.restarts} times")
    saturated = int(np.sum(~samples.good)) - samples.repeated
    if saturated > 0:
        said.append(f"{saturated} samples are saturated; use a larger full scale or lower speeds")
    if solution.outliers > 1e-3 * samples.good.size:
        said.append(f"{solution.outliers} samples were set aside as spikes")
    return tuple(said)


def _distrust(solution: Solution, concluded: Concluded, chi2: float) -> tuple[str, ...]:
    reasons = []
    if not solution.converged:
        reasons.append("the fit did not settle: a part of the model is wrong; look at the residual")
    if chi2 > CHI2_LIMIT:
        reasons.append(
            f"while moving the residual is {chi2:.2f} times the noise at rest: the model of the "
            "rig lacks something; look at the residual over time and angle"
        )
    reasons += [f"not identified: {text}" for text in concluded.observability.reasons]
    return tuple(reasons)


def _diagnostics(
    solution: Solution, series: list[Series], moving: list[BoolArray]
) -> FitDiagnostics:
    times = []
    for s in series:
        n = s.blocks * s.block
        times.append(s.time_s[:n].reshape(s.blocks, s.block).mean(axis=1))
    used = np.concatenate([m.used for m in solution.models])[:, None]
    residual = np.concatenate(solution.residuals)
    spectrum = solution.spectrum
    return FitDiagnostics(
        time_s=np.concatenate(times),
        rate_rad_s=np.where(used, np.concatenate([m.measured for m in solution.models]), np.nan),
        reference_rad_s=np.where(used, np.concatenate([m.rate for m in solution.models]), np.nan),
        residual_rad_s=np.where(used, residual, np.nan),
        whitened=np.where(used, np.concatenate(solution.whitened), np.nan),
        moving=np.concatenate(moving),
        frequency_hz=spectrum.frequency_hz,
        spectrum=spectrum.density,
        spectrum_model=solution.noise.density(spectrum.frequency_hz),
    )


def solve_recording(recording: Recording, board: str) -> GyroFit:
    """Calibrate one board of one recording; see `solve_recordings`."""
    return solve_recordings([recording], board)
