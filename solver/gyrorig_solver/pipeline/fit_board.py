"""Fit one board by the best reference that its recordings have.

What to use when: `solve_recordings` from recordings, `fit_board` where they are loaded already.
Several boards that were on one unit at the same time are fitted in `criticised_fit`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.data.samples import GyroSamples, positive_number
from gyrorig_solver.estimate import (
    REST_REMEDIES,
    FittedTerm,
    GyroFit,
    fit_attitude,
    fit_gravity,
    fit_motion,
    fit_turns,
)
from gyrorig_solver.pipeline.board_data import ATTITUDE_TOPIC, BoardData, load_board
from gyrorig_solver.pipeline.prepare_board import prepare_board
from gyrorig_solver.reference import AttitudeReference, RestReference, mostly_at_rest, read_attitude

STANDARD_GRAVITY_M_S2 = 9.80665  # CGPM 1901; only the accelerometer's scale depends on it


def solve_recordings(
    recordings: Sequence[Recording],
    board: str,
    extend: Sequence[str] = (),
    named_terms: Sequence[FittedTerm] = (),
) -> GyroFit:
    """Calibrate one board by the best reference of its recordings; see `fit_board`.

    Args:
        recordings: in any order.
        board: in each of them.
        extend: causes of the catalogue to fit in addition to the base model; with a unit only.
        named_terms: causes that a search named, to fit too; with a unit only.

    Raises:
        InputError: the board is not in a recording, or there is no reference of any kind.
        UsageError: the recordings cannot be solved together, or a cause is unknown.
    """
    return fit_board(load_board(recordings, board), extend, named_terms)


def fit_board(
    data: BoardData, extend: Sequence[str] = (), named_terms: Sequence[FittedTerm] = ()
) -> GyroFit:
    """Calibrate a board by the best reference of its recordings.

    References are tried in this order: a pan-tilt unit's motion, reference attitudes, turns by
    known angles, rest, gravity between rests. All but gravity take several recordings, each
    with its own bias and time offset. Arguments and errors as in `solve_recordings`.
    """
    fit = _fit_best_reference(data, extend, named_terms)
    return replace(fit, warnings=(*missing_data(data.recordings), *fit.warnings))


def missing_data(recordings: Sequence[Recording]) -> list[str]:
    """Return what the recordings report as missing, one text for each loss."""
    return [f"{r.path.name}: {loss.text}" for r in recordings for loss in r.losses]


def attitude_reference(recording: Recording, samples: GyroSamples) -> AttitudeReference:
    """Return a recording's attitudes on its samples' time axis.

    Raises:
        InputError: no attitude is usable.
    """
    raw = recording.reference_attitude()
    time_s = np.asarray((times_ns(raw["host_time"]) - samples.origin_ns) * 1e-9, np.float64)
    return read_attitude(time_s, raw["orientation"], raw["standard_deviation"])


def _fit_best_reference(
    data: BoardData, extend: Sequence[str], named_terms: Sequence[FittedTerm]
) -> GyroFit:
    if data.has_unit:
        prepared = prepare_board(data, extend, named_terms)
        return prepared.summarize(prepared.solve())
    if extend:
        raise UsageError(
            "the option --extend needs a recording with a pan-tilt unit",
            "leave out --extend, or record the board on a pan-tilt unit",
        )
    if data.has_attitudes:
        return fit_attitude(
            [
                (samples, attitude_reference(recording, samples))
                for recording, samples in zip(data.recordings, data.samples, strict=True)
                if ATTITUDE_TOPIC in recording.topics
            ]
        )
    if any(turns.turns for turns in data.known_turns):
        return fit_turns(list(zip(data.samples, data.known_turns, strict=True)))
    return _fit_gravity_or_rest(data)


def _fit_gravity_or_rest(data: BoardData) -> GyroFit:
    if len(data.recordings) > 1:
        raise UsageError(
            f"{len(data.recordings)} recordings without a pan-tilt unit, attitudes or known turns "
            "cannot be solved together",
            "run `gyrorig solve` once for each recording",
        )
    (recording,), (samples,), (known_turns,) = data.recordings, data.samples, data.known_turns
    if mostly_at_rest(known_turns.rests, float(samples.time_s[-1] - samples.time_s[0])):
        return fit_motion(samples, RestReference(known_turns.rests), REST_REMEDIES)
    if samples.accel_m_s2 is None:
        raise InputError(
            f"the recording {recording.path.name} has no reference to compare the rates with",
            "record a pan-tilt unit, reference attitudes, known turns or the board's accelerometer "
            "too",
        )
    site = recording.metadata.get("gyrorig.site", {})
    gravity = positive_number(site, "gravity_m_s2") or STANDARD_GRAVITY_M_S2
    return fit_gravity(samples, gravity, known_turns.rests[0] if known_turns.rests else None)
