"""From a recording to a fit: choose the reference, solve, conclude.

What to use when: `solve_recordings` is the whole way for one board. Those of a unit are in
`on_unit`, several boards that were on one at once in `together`. The estimators are in
`estimate`, one for each kind of reference.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.estimate.attitude import fit_attitude
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.gravity import fit_gravity
from gyrorig_solver.estimate.motion import fit_motion
from gyrorig_solver.estimate.result import GyroFit
from gyrorig_solver.estimate.turns import fit_turns
from gyrorig_solver.on_unit import begun
from gyrorig_solver.reference.attitude import AttitudeReference, read_attitude
from gyrorig_solver.reference.rest import RestReference, mostly_at_rest
from gyrorig_solver.reference.turns import TurnReference, read_turns
from gyrorig_solver.samples import GyroSamples, load_samples, number

REST_WORDS = {
    "x": "the board lay still; turn it about all three axes by a reference",
    "y": "the board lay still; turn it about all three axes by a reference",
    "z": "the board lay still; turn it about all three axes by a reference",
    "bias": "there are too few samples; record at rest for a minute",
    "time_offset": "nothing moved; use a moving reference",
}
STANDARD_GRAVITY_M_S2 = 9.80665  # CGPM 1901; only the accelerometer's scale rests on it


def solve_recordings(
    recordings: Sequence[Recording],
    board: str,
    extend: Sequence[str] = (),
    named: Sequence[Extension] = (),
) -> GyroFit:
    """Calibrate one board by the best reference that its recordings hold.

    In this order: a pan-tilt unit's motion, reference attitudes, turns by known angles,
    rest, gravity between rests. All but gravity may be spread over several recordings:
    those of a unit, and at rest, are fitted jointly, bias and time offset free in each.

    Args:
        recordings: in any order.
        board: in each of them.
        extend: causes of the catalogue to fit beside the base model; with a unit only.
        named: causes as a search named them, to fit too; with a unit only.

    Raises:
        InputError: the board is not there, or there is no reference of any kind.
        UsageError: recordings that cannot be solved together, or an unknown cause.
    """
    ordered = sorted(recordings, key=lambda recording: recording.start_ns)
    fit = _by_best_reference(ordered, board, extend, named)
    missing = tuple(f"{r.path.name}: {loss.text}" for r in ordered for loss in r.losses)
    return replace(fit, warnings=(*missing, *fit.warnings))


def _by_best_reference(
    recordings: Sequence[Recording], board: str, extend: Sequence[str], named: Sequence[Extension]
) -> GyroFit:
    loaded = [(recording, load_samples(recording, board)) for recording in recordings]
    if any("/ptu/position" in r.topics for r in recordings):
        return _by_unit(loaded, extend, named)
    if extend:
        raise UsageError(
            "causes beyond the base model need a recording of a pan-tilt unit",
            "leave out --extend, or record the board on a unit",
        )
    attitudes = [(s, _attitude(r, s)) for r, s in loaded if "/reference/attitude" in r.topics]
    if attitudes:
        return fit_attitude(attitudes)
    turns = [(s, read_turns(r.events(), s.origin_ns)) for r, s in loaded]
    if any(found.turns for _, found in turns):
        return fit_turns(turns)
    return _by_gravity(loaded, turns)


def _by_unit(
    loaded: list[tuple[Recording, GyroSamples]],
    extend: Sequence[str],
    named: Sequence[Extension],
) -> GyroFit:
    """Fit a board on a unit: recordings in motion and at rest, together."""
    ready = begun(loaded, extend, named)
    return ready.concluded(ready.solution())


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
        return fit_motion(samples, RestReference(found.rests), REST_WORDS)
    if samples.accel_m_s2 is None:
        raise InputError(
            f"{recording.path.name} holds no reference",
            "give it positions of a unit, attitudes, known turns, or an accelerometer",
        )
    site = recording.metadata.get("gyrorig.site", {})
    gravity = number(site, "gravity_m_s2") or STANDARD_GRAVITY_M_S2
    return fit_gravity(samples, gravity, found.rests[0] if found.rests else None)


def solve_recording(recording: Recording, board: str) -> GyroFit:
    """Calibrate one board of one recording; see `solve_recordings`."""
    return solve_recordings([recording], board)
