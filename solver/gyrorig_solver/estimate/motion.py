"""The fit against a reference motion, concluded: a board on a unit, or lying still.

What to use when: `fit_motion` for one board and one `ReferenceMotion`; `likelihood` holds
the estimator itself.
"""

from collections.abc import Mapping

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.estimate.conclusion import TERMS, Evidence, gyro_fit
from gyrorig_solver.estimate.likelihood import MOVING_RAD_S, Solution, solve_likelihood
from gyrorig_solver.estimate.rest_to_rest import CrossCheck, Path, cross_check
from gyrorig_solver.estimate.result import FitDiagnostics, GyroFit, NoiseLevels
from gyrorig_solver.estimate.series import Series, build_series
from gyrorig_solver.reference.motion import ReferenceMotion
from gyrorig_solver.reference.ptu import PtuReference
from gyrorig_solver.reference.rests import DETENT_VARIANCE
from gyrorig_solver.samples import GyroSamples

# Whitened variance while moving over that at rest: above this, motion is not explained.
CHI2_LIMIT = 1.25
HELD_OUT_WINDOW_S = 10.0
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
    """Fit samples against a reference motion and conclude what may be said.

    Args:
        samples: of one board.
        reference: the stage's motion, times on the samples' axis.
        words: for each gain column, `bias` and `time_offset`, why it may be hidden.
        warnings: what is already known to be odd, in words.

    Raises:
        InputError: no sample has a reference.
    """
    series, sampling = build_series(samples)
    stamp_std_s = samples.floor.std_s if samples.floor else 0.0
    solution = solve_likelihood(series, sampling, reference, stamp_std_s)
    moving = [np.linalg.norm(m.rate, axis=1) > MOVING_RAD_S for m in solution.models]
    chi2 = _reduced_chi2(solution, moving)
    before, after = _held_out(solution)
    turning = np.concatenate([m.rate @ solution.gain.T for m in solution.models])
    second = _second_opinion(solution, series)
    if second is not None and second.p_value < DISAGREEMENT_P:
        warnings = (
            *warnings,
            f"the turns from rest to rest disagree with the rates by {second.largest_sigma:.1f} "
            "standard deviations: timing is the suspect; look at clocks and commands",
        )
    if solution.outliers > SPIKES_WORTH_A_WORD * samples.good.size:
        warnings = (*warnings, f"{solution.outliers} samples were set aside as spikes")
    evidence = Evidence(
        estimate=solution.estimate,
        decision=solution.decision,
        reduced_chi2=chi2,
        outliers=solution.outliers,
        rms_before_rad_s=before,
        rms_after_rad_s=after,
        reference=reference.description,
        words=words,
        terms=(*TERMS, "time_offset"),
        warnings=warnings,
        distrust=_distrust(solution, chi2),
        diagnostics=_diagnostics(solution, series, moving),
        chi2_limit=float("inf"),  # said in this reference's own words
        noise=_levels(solution),
        rate_range_rad_s=(float(turning.min()), float(turning.max())),
        clock_truth="the host's capture clock",
        extra=_said(second),
    )
    return gyro_fit(evidence, [samples])


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


def _second_opinion(solution: Solution, series: list[Series]) -> CrossCheck | None:
    """Compare the fit with the turns from rest to rest, where a unit made them."""
    reference = solution.reference
    if not isinstance(reference, PtuReference):
        return None
    paths = []
    for stretch, model in zip(series, solution.models, strict=True):
        time_s = _block_times(stretch) - solution.estimate[12]
        moving = np.linalg.norm(model.rate, axis=1) > STANDING_RAD_S
        paths.append(Path(time_s, model.measured, model.used, moving, reference.angles_rad(time_s)))
    density = float(solution.noise.density(np.array([REST_TO_REST_HZ])).max())
    step_rad = float(np.max(np.abs(reference.rad_per_step)))
    return cross_check(
        paths,
        solution.gain,
        solution.bias_rad_s,
        solution.decision,
        density,
        (reference.starts.rest_variance + DETENT_VARIANCE) * step_rad**2,
    )


def _said(second: CrossCheck | None) -> dict[str, float]:
    if second is None:
        return {}
    return {
        "rest_to_rest_moves": float(second.moves),
        "rest_to_rest_p_value": second.p_value,
        "rest_to_rest_largest_sigma": second.largest_sigma,
    }


def _block_times(series: Series) -> FloatArray:
    n = series.blocks * series.block
    return np.asarray(series.time_s[:n].reshape(series.blocks, series.block).mean(axis=1))


def _levels(solution: Solution) -> NoiseLevels:
    levels = np.sqrt(solution.noise.levels)
    return NoiseLevels(
        angle_random_walk=levels[:, 0],
        bias_instability=levels[:, 1],
        rate_random_walk=levels[:, 2],
        source="spectrum of the residual, whole recording",
    )


def _distrust(solution: Solution, chi2: float) -> tuple[str, ...]:
    reasons = []
    if not solution.converged:
        reasons.append("the fit did not settle: a part of the model is wrong; look at the residual")
    if chi2 > CHI2_LIMIT:
        reasons.append(
            f"while moving the residual is {chi2:.2f} times the noise at rest: the model of the "
            "rig lacks something; look at the residual over time and angle"
        )
    return tuple(reasons)


def _diagnostics(
    solution: Solution, series: list[Series], moving: list[BoolArray]
) -> FitDiagnostics:
    times = [_block_times(s) for s in series]
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
