"""What the finder says of one recording, as one plain line: written before any answer is opened.

What to use when: `explained` for the finder as it ships (or one that `look` puts in its place),
`line_of` for what is kept of it.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.calibration.profiles import find_profile
from gyrorig_solver.discover.changes import PARAMETERS, Board
from gyrorig_solver.discover.finder import explain
from gyrorig_solver.discover.result import Explained, Findings, NamedCause
from gyrorig_solver.estimate.likelihood import GAINS, PER_SESSION, Solution
from gyrorig_solver.findings.build import Origin, RawEvidence, document_of
from gyrorig_solver.findings.document import Cause, FindingsDocument, Input, Subject
from gyrorig_solver.findings.wording import summary
from gyrorig_solver.model.terms.protocol import indices, value_names
from gyrorig_solver.raw.checks import look_at
from gyrorig_solver.raw.gain import look_at_gain
from gyrorig_solver.samples import load_samples

Look = Callable[[Sequence[Recording], str], Explained]
NOTHING_OPENED = "2000-01-01T00:00:00Z"  # documents that are compared carry no clock's time
DIGITS = 7
MOVES_BIAS = ("bias_ramp", "bias_step", "thermal_bias", "warm_up")


@dataclass(frozen=True, slots=True, eq=False)
class Stated:
    """All that was said of one recording, with the fits it rests on."""

    recording: Recording
    explained: Explained
    document: FindingsDocument


def explained(path: Path, look: Look = explain) -> Stated:
    """Explain the first board of a recording as `gyrorig explain` does, without pictures."""
    recording = read_recording(path)
    board = recording.board_ids[0]
    raw = [RawEvidence(recording.path.name, look_at(load_samples(recording, board)))]
    found = look([recording], board)
    metadata = recording.metadata.get(f"gyrorig.board.{board}", {})
    profile = find_profile(metadata.get("sensor", ""))
    tolerance = None if profile is None else profile.scale_tolerance
    gain = look_at_gain(np.asarray(found.solution_extended.gain), tolerance)
    raw.append(RawEvidence(recording.path.name, gain))
    origin = Origin(
        Subject(board, metadata.get("sensor", "")),
        [Input(recording.path.name, recording.sha256)],
        NOTHING_OPENED,
        "",
    )
    return Stated(recording, found, document_of(found.findings, raw, origin))


def line_of(seed: int, variant: str, stated: Stated) -> dict[str, Any]:
    """Return what is kept: names, sizes, rest, calibration, limits; plain JSON."""
    findings = stated.explained.findings
    rest = findings.unexplained
    named = {one.cause for one in findings.causes}
    return {
        "seed": seed,
        "variant": variant,
        "verdict": stated.document.verdict,
        "causes": [_named(one) for one in findings.causes],
        "raw": [_raw(one) for one in stated.document.causes if one.cause not in named],
        "unexplained": [s.covariate for s in (rest.best, *rest.others)] if rest else [],
        "signatures": [s.covariate for s in findings.signatures[:3]],
        "nats": _short(findings.gain.log_likelihood.value) if findings.gain else None,
        "calibration": _calibration(stated.explained),
        "absent": [
            [one.cause, one.where, _short(one.size), one.moves, _short(one.harm_sigma)]
            for one in findings.absent
        ],
        "not_testable": sorted({one.cause for one in stated.document.not_testable}),
        "harm_printed": _harm_printed(findings, stated.document),
        "seconds": round(findings.seconds, 2),
    }


def _named(one: NamedCause) -> dict[str, Any]:
    return {
        "set": list(one.candidates),
        "where": list(one.where),
        "values": {v.name: [_short(v.value), _short(v.std)] for v in one.values},
        "free": int(one.extension.free.size),
        "sizes": [value_names(one.term)[k] for k in indices(one.term, role="size")],
        "statistic": _short(one.statistic),
        "posterior": _short(one.posterior),
        "harm_sigma": _short(one.harm_sigma),
        "sigma": {c.parameter: _short(c.sigma) for c in one.changes[:3]},
    }


def _raw(one: Cause) -> dict[str, Any]:
    return {"set": [one.cause, *one.one_of], "where": one.where}


def _calibration(found: Explained) -> dict[str, list[float | None]]:
    """Return each parameter's value and deviation beside the named causes, and without.

    The truth's bias is its mean over the recording; beside a named cause that moves the bias
    the calibration's is where that cause is zero, so its mean is put in.
    """
    after, before = Board.of(found.solution_extended), Board.of(found.solution_base)
    value, std = after.values.copy(), after.std.copy()
    shift, variance = _mean_of_moves(found.solution_extended)
    at = [k for k, name in enumerate(PARAMETERS) if name.startswith("bias.")]
    value[at] += shift
    std[at] = np.where(np.isfinite(std[at]), np.sqrt(variance), np.nan)
    return {
        name: [_short(float(value[k])), _short(float(std[k])), _short(float(before.values[k]))]
        for k, name in enumerate(PARAMETERS)
    }


def _mean_of_moves(solution: Solution) -> tuple[FloatArray, FloatArray]:
    """Return what causes that move the bias add to its mean, (3,), and that sum's variance."""
    covariance = solution.decision.covariance
    own = np.arange(GAINS, GAINS + 3)
    moving = [one for one in solution.extensions if one.term.cause in MOVES_BIAS]
    if not moving:
        return np.zeros(3), np.diag(covariance)[own]
    shift, blocks = np.zeros(3), 0
    along = np.zeros((3, covariance.shape[0]))
    for _, _, model, _, scene in solution.sessions[-1].derivatives(solution.gain):
        blocks += int(model.used.sum())
        at = GAINS + PER_SESSION
        for one in solution.extensions:
            if one.term.cause in MOVES_BIAS:
                shift += one.term.effect(scene, one.values)[model.used].sum(axis=0)
                columns = one.term.columns(scene, one.values)[one.free]
                along[:, at : at + one.free.size] += columns[:, model.used].sum(axis=1).T
            at += one.free.size
    along /= blocks
    along[:, own] += np.eye(3)
    return shift / blocks, np.einsum("ij,jk,ik->i", along, covariance, along)


def _harm_printed(findings: Findings, document: FindingsDocument) -> bool:
    """Return whether what could do most harm unseen is in the document and is said aloud."""
    if not findings.absent:
        return True
    worst = max(findings.absent, key=lambda one: one.harm_sigma)
    kept = any(
        one.cause == worst.cause
        and one.where == worst.where
        and one.by_sigma is not None
        and math.isclose(one.by_sigma, worst.harm_sigma, rel_tol=1e-6)
        for one in document.minimal_detectable
    )
    return kept and f"could be there unseen {worst.cause}" in summary(document)


def _short(value: float) -> float | None:
    """Return a number with as many digits as a comparison needs, None for none."""
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
