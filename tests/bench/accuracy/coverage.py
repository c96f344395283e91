"""Coverage of the stated 95 % intervals, for each shipped program and each parameter apart.

Nothing is hidden in these runs: board, noise and unit are those of the other cases. A pooled
figure can hide one parameter of one program whose intervals are wrong, so nothing is pooled
here. A null has no interval and is counted.

What to use when: `run_program` for one run, `summarise_program` for many runs of a program,
`coverage_rows` for the judgement of all.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path as File
from typing import Any
from zlib import crc32

import numpy as np
from scipy import stats
from tests.bench.accuracy import goals
from tests.bench.accuracy.board import NAMES, draw_board, sample
from tests.bench.accuracy.figures import SIGMA_95
from tests.bench.accuracy.given import answered_reference, samples_of
from tests.bench.accuracy.profile import FloatArray
from tests.bench.accuracy.summary import Row, Summary
from tests.bench.accuracy.trial import HEAD_S, PROGRAMS, TAIL_S, load_program, truth
from tests.bench.accuracy.unit import carry_out

from gyrorig_solver.estimate import UNIT_REMEDIES, fit_motion

RATE_HZ, BANDWIDTH_HZ, BAUD = 100.0, 25.0, 115_200.0
FIRST_SEED = 4  # other cases begin their seeds with their number, 1 to 3
GAIN_NAMES = tuple(f"gain.{row}{column}" for row in "xyz" for column in "xyz")
APART = "time_offset, its constant apart"
ALL_NAMES = (*NAMES, APART, *GAIN_NAMES)


def shipped_programs() -> tuple[str, ...]:
    """Return the files of config/programs, in alphabetical order."""
    return tuple(sorted(path.name for path in File(PROGRAMS).glob("*.yaml")))


def run_program(program: str, seed: int) -> dict[str, Any]:
    """Return error and stated standard deviation of every parameter of one run; None if null."""
    rng = np.random.default_rng([FIRST_SEED, crc32(program.encode()), seed])
    session = carry_out(load_program(program), BAUD, rng)
    board = draw_board(RATE_HZ, BANDWIDTH_HZ, rng)
    counts = sample(board, session.path, (HEAD_S, session.end_s - TAIL_S), rng)
    reference = answered_reference(session)
    fit = fit_motion(samples_of(board, counts), reference, UNIT_REMEDIES)
    error = np.array([fit.value(name) for name in NAMES]) - truth(board, counts)
    std = np.array([fit.std[name] for name in NAMES])
    apart_variance = std[-1] ** 2 - reference.common_shift_std_s**2
    errors = np.concatenate(
        [error, [error[-1] - session.common_s], (fit.gain - board.gain).ravel()]
    )
    stds = np.concatenate([std, [np.sqrt(max(apart_variance, 0.0))], fit.gain_std.ravel()])
    is_null = ~(np.isfinite(errors) & np.isfinite(stds))
    return {
        "seed": seed,
        "error": [None if null else float(e) for e, null in zip(errors, is_null, strict=True)],
        "std": [None if null else float(s) for s, null in zip(stds, is_null, strict=True)],
        "duration_s": session.end_s,
    }


def summarise_program(rows: Sequence[dict[str, Any]]) -> Summary:
    """Return nulls, coverage with its Clopper-Pearson limits and the spread of each parameter."""
    whole = [row for row in rows if "error" in row]
    error = np.array([row["error"] for row in whole], dtype=np.float64)
    std = np.array([row["std"] for row in whole], dtype=np.float64)
    return {
        "runs": len(whole),
        "failed": len(rows) - len(whole),
        "duration_s": float(np.median([row["duration_s"] for row in whole])),
        "parameters": {name: _coverage(error[:, k], std[:, k]) for k, name in enumerate(ALL_NAMES)},
    }


def _coverage(error: FloatArray, std: FloatArray) -> Summary:
    stated = np.isfinite(std)
    figures: Summary = {"nulls": int(np.sum(~stated))}
    if stated.any():
        z = error[stated] / std[stated]
        inside = int(np.sum(np.abs(z) <= SIGMA_95))
        limits = stats.binomtest(inside, z.size).proportion_ci(0.95)
        figures |= {
            "value": inside / z.size,
            "low": float(limits.low),
            "high": float(limits.high),
            "rms_z": float(np.sqrt(np.mean(z**2))),
            "largest_z": float(np.max(np.abs(z))),
        }
    return figures


def verdict(figures: Summary) -> str:
    """Return whether a coverage meets the goal: yes; no, within chance; NO; empty if all null."""
    if "value" not in figures:
        return ""
    low, high = goals.COVER_95
    if low <= figures["value"] <= high:
        return "yes"
    return "no, within chance" if figures["low"] <= high and figures["high"] >= low else "NO"


def coverage_rows(programs: Summary) -> Iterator[Row]:
    """Yield one row of the table of goals for each program and parameter that has intervals."""
    low, high = goals.COVER_95
    for program, summary in programs.items():
        for name, figures in summary["parameters"].items():
            words = verdict(figures)
            if words:
                yield Row(
                    f"{program}: 95 % intervals, {name}",
                    f"{low:.2f} to {high:.2f}",
                    f"{figures['value']:.3f} ({figures['low']:.3f} to {figures['high']:.3f})",
                    words,
                )
