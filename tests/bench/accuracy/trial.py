"""One simulated run: drawn, solved, and held against the truth and the bound."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path as File
from typing import Any

import numpy as np
from tests.bench.accuracy.board import NAMES, Board, Counts, draw_board, factors, sample
from tests.bench.accuracy.bound import bound
from tests.bench.accuracy.given import ExactReference, answered_reference, samples_of
from tests.bench.accuracy.motor_noise import MotorNoise
from tests.bench.accuracy.profile import FloatArray
from tests.bench.accuracy.unit import Session, carry_out

from gyrorig_protocol.program import MotionProgram, parse_program
from gyrorig_solver.estimate import UNIT_REMEDIES, ConvergedFit, GyroFit, fit_motion
from gyrorig_solver.estimate.motion_fit import solve_motion
from gyrorig_solver.reference import ReferenceMotion

PROGRAMS = File(__file__).resolve().parents[3] / "config" / "programs"
HEAD_S, TAIL_S = 0.5, 0.4  # of polls without samples at both ends


@dataclass(frozen=True, slots=True)
class Case:
    """One kind of run."""

    name: str
    program: str  # a file of config/programs
    rate_hz: float = 100.0
    bandwidth_hz: float = 25.0
    baud: float | None = None  # None: the stage's motion is known exactly
    counter: bool = False  # the unit answers BT, with its own counter
    spikes: float = 0.0  # share of samples hit
    share: float = 1.0  # of the runs that are asked for: some cases cost more
    number: int = 0  # cases of one number have the same boards, noise and unit
    motor_noise: MotorNoise | None = None


def run(case: Case, seed: int) -> dict[str, Any]:
    """Return what came of one run, ready for JSON.

    `error`, `std` and `bound` are over `NAMES`; `best` is the error of a linear estimate that
    reaches the bound, on the same noise.
    """
    board, session, counts, rng = simulate(case, seed)
    best = bound(board, session, counts, profile_known=case.baud is None)
    given = spiked(board, counts, case.spikes, rng) if case.spikes else counts
    reference = reference_of(case, session)
    fit = fit_motion(samples_of(board, given), reference, UNIT_REMEDIES)
    true = truth(board, counts)
    error = np.array([fit.value(name) for name in NAMES]) - true
    at = {name: k for k, name in enumerate(fit.order)}
    shown = [name for name in NAMES if name in at]
    pick = np.array([at[name] for name in shown])
    covariance = fit.covariance[np.ix_(pick, pick)]
    left = error[[NAMES.index(name) for name in shown]]
    return {
        "seed": seed,
        "error": error.tolist(),
        "std": [fit.std[name] for name in NAMES],
        "bound": np.sqrt(np.diag(best.covariance)).tolist(),
        "best": best.error.tolist(),
        "best_chi2": float(best.error @ np.linalg.solve(best.covariance, best.error)),
        "chi2": float(left @ np.linalg.solve(covariance, left)),
        "shown": len(shown),
        "bias_at_begin": (error[:3] + true[:3] - counts.bias_rad_s[0]).tolist(),
        "common_s": 0.0 if case.baud is None else session.common_s,
        "common_std_s": 0.0 if case.baud is None else session.least_s / float(np.sqrt(12.0)),
        "stated_common_s": reference.common_shift_std_s,
        "outliers": fit.outliers,
        "reduced_chi2": fit.reduced_chi2,
        "reference": fit.reference,
        "warnings": list(fit.warnings),
        "distrust": list(fit.limited_reasons),
        "noise": _noise(board, fit),
        "duration_s": session.end_s,
    }


def simulate(case: Case, seed: int) -> tuple[Board, Session, Counts, np.random.Generator]:
    """Return board, unit and samples of one run, and the generator behind them."""
    rng = np.random.default_rng([case.number, seed])
    program = load_program(case.program)
    session = carry_out(program, case.baud or 115_200.0, rng, case.counter)
    board = draw_board(case.rate_hz, case.bandwidth_hz, rng)
    span_s = HEAD_S, session.end_s - TAIL_S
    return board, session, sample(board, session.path, span_s, rng, case.motor_noise), rng


def reference_of(case: Case, session: Session) -> ReferenceMotion:
    """Return what the solver compares the samples with."""
    return ExactReference(session.path) if case.baud is None else answered_reference(session)


def solve_case(case: Case, seed: int) -> ConvergedFit:
    """Return the fit of one run."""
    board, session, counts, _ = simulate(case, seed)
    return solve_motion([(samples_of(board, counts), reference_of(case, session))])


def run_without_bound(case: Case, seed: int) -> dict[str, Any]:
    """Return what came of one run whose bound nobody knows: error, std and noise in motion."""
    board, session, counts, _ = simulate(case, seed)
    fit = fit_motion(samples_of(board, counts), reference_of(case, session), UNIT_REMEDIES)
    white = {} if fit.noise is None else fit.noise.white_by_motor_state
    at_rest = np.ones(3) if fit.noise is None else fit.noise.angle_random_walk
    return {
        "seed": seed,
        "error": (np.array([fit.value(name) for name in NAMES]) - truth(board, counts)).tolist(),
        "std": [fit.std[name] for name in NAMES],
        "noise_ratio": (white.get("in_motion", at_rest) / at_rest).tolist(),
        "reduced_chi2": fit.reduced_chi2,
        "widened": any("multiplied the standard uncertainties" in text for text in fit.warnings),
    }


def _noise(board: Board, fit: GyroFit) -> list[list[float]]:
    """Return the levels found over the true ones: white, flicker, walk; three axes each."""
    if fit.noise is None:
        return []
    ratios = (
        fit.noise.angle_random_walk / [level.white for level in board.levels],
        fit.noise.bias_instability / [level.flicker for level in board.levels],
        fit.noise.rate_random_walk / [level.walk for level in board.levels],
    )
    return [[float(value) for value in ratio] for ratio in ratios]


def truth(board: Board, counts: Counts) -> FloatArray:
    """Return the true parameters in the order of `NAMES`; the bias is its mean."""
    return np.concatenate([counts.bias_rad_s.mean(axis=0), factors(board.gain), [board.delay_s]])


def spiked(board: Board, counts: Counts, share: float, rng: np.random.Generator) -> Counts:
    """Return the counts with glitches: single samples, runs of three, torn bytes."""
    rate = counts.rate_rad_s.copy()
    n, quantum = rate.shape[0], board.levels[0].quantum_rad_s
    hit = 0
    while hit < share * n:
        at, axis, kind = int(rng.integers(n - 3)), int(rng.integers(3)), int(rng.integers(3))
        sign = float(rng.choice([-1.0, 1.0]))
        if kind == 0:
            rate[at, axis] += sign * quantum * round(float(rng.uniform(200, 20_000)))
        elif kind == 1:
            rate[at : at + 3] += quantum * np.rint(rng.uniform(-5000, 5000, size=3))
        else:
            rate[at, axis] += sign * 256.0 * quantum
        hit += 3 if kind == 1 else 1
    return replace(counts, rate_rad_s=rate)


@cache
def load_program(name: str) -> MotionProgram:
    """Return a program of config/programs by its file name."""
    return parse_program((PROGRAMS / name).read_text(encoding="utf-8"), name)
