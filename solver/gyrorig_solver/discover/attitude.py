"""Explain a board beside reference attitudes: what the fit leaves, named as far as data bear it.

The catalogue's causes of the sensor, the clock and the mount are looked for as on a unit: a
pass over all, the leading ones and their siblings fitted exactly, the one of most evidence
kept, until nothing is significant. Two rules more, since here the reference is the noisy side
and nobody knows its noise: scores are judged by how much they vary from one stretch of time to
the next, and a cause whose gain on windows left out is not above zero is not named.

What to use when: `explain_attitudes` from recordings.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.discover.attitude_gain import WINDOW_S, gain_of, gains, nameable
from gyrorig_solver.discover.attitude_groups import attitude_signatures, groups_of
from gyrorig_solver.discover.attitude_search import Standing, p_value, search_beside
from gyrorig_solver.discover.attitude_terms import OR_THE_REFERENCE, terms_beside
from gyrorig_solver.discover.changes import Board, own_part
from gyrorig_solver.discover.limits import limits
from gyrorig_solver.discover.result import (
    Findings,
    Gain,
    NamedCause,
    NotTestable,
    Signature,
    Unexplained,
    Value,
    Verdict,
)
from gyrorig_solver.discover.rivals import rivals_of
from gyrorig_solver.discover.scores import sights
from gyrorig_solver.discover.search import ALPHA, STATED, tests_of
from gyrorig_solver.estimate.attitude import Settled, conclude, settle
from gyrorig_solver.estimate.attitude_space import AttitudeSpace, Forces
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.result import GyroFit
from gyrorig_solver.model.gain import factor_jacobian, factorise
from gyrorig_solver.model.terms.bound import label
from gyrorig_solver.model.terms.protocol import Term, indices, places, value_names, value_parameters
from gyrorig_solver.model.terms.scene import Setting
from gyrorig_solver.reference.attitude import AttitudeReference, read_attitude
from gyrorig_solver.samples import GyroSamples, load_samples
from gyrorig_solver.setting import settings_of

WORDS = {"moving_bias": "on whether the board moves, as a bias"}
SHOWN_SIGMA = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeExplained:
    """Findings, the fit they rest on, and the space of the last fit for pictures."""

    findings: Findings
    fit: GyroFit
    space: AttitudeSpace
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """One recording's gyro beside its reference attitudes."""

    name: str
    samples: GyroSamples
    reference: AttitudeReference
    setting: Setting


def explain_attitudes(
    recordings: Sequence[Recording], board: str, held_out: Recording | None = None
) -> AttitudeExplained:
    """Find what gain, bias and lag leave of one board beside its reference attitudes.

    Args:
        recordings: each with a reference attitude; bias and lag are each one's own.
        board: in each of them.
        held_out: another one, on which what was found is judged.

    Raises:
        InputError: the board is not there, or gyro and reference hardly overlap.
    """
    elsewhere = None if held_out is None else _loaded([held_out], board)[0]
    return explain_beside(_loaded(recordings, board), elsewhere)


def explain_beside(
    recordings: Sequence[Beside], held_out: Beside | None = None
) -> AttitudeExplained:
    """Do as `explain_attitudes` does with what recordings hold.

    Raises:
        InputError: gyro and reference hardly overlap.
    """
    begin = time.monotonic()
    space, settled = _space(recordings)
    fit = conclude(settled, [(one.samples, one.reference) for one in recordings])
    terms, blind = terms_beside(space)
    tests = tests_of(terms)
    shown = attitude_signatures(space)
    standings = search_beside(space, terms, tests)
    last = space.with_causes([one.best.extension for one in standings])
    unexplained = _unexplained(standings, attitude_signatures(last), tests)
    gain, each = gains(last)
    calibration = _board(settled, fit)
    causes = [
        _named(last, k, one, calibration, tests, each[k] if each else None)
        for k, one in enumerate(standings)
        if nameable(last.extensions[k])
    ]
    causes.sort(key=lambda one: (-one.harm_sigma, one.p_value))
    taken = {label(one.term) for one in last.extensions}
    left = sights(last, [t for t in terms if label(t) not in taken], tests)
    absent, unseen = limits(last, left, calibration, space.recordings)
    verdict: Verdict = "explained" if causes else "adequate"
    findings = Findings(
        verdict="unexplained" if unexplained is not None else verdict,
        causes=tuple(causes),
        unexplained=unexplained,
        signatures=tuple(shown),
        absent=absent,
        not_testable=(
            *(one for one in unseen if one.cause not in dict(blind)),
            *(NotTestable(cause, None, why) for cause, why in blind),
        ),
        base_terms=fit.terms,
        base_reduced_chi2=fit.reduced_chi2,
        base_whiteness_p=shown[0].p_value,
        extended_reduced_chi2=fit.reduced_chi2,
        gain=gain,
        changes=calibration.changes(calibration.values - _moved(last, space, calibration)),
        seconds=time.monotonic() - begin,
        elsewhere=None if held_out is None else gain_elsewhere(last, held_out),
    )
    said = [
        f"{c.cause}: {OR_THE_REFERENCE[c.cause]}" for c in causes if c.cause in OR_THE_REFERENCE
    ]
    said += [
        _nameless(one, each[k] if each else None)
        for k, one in enumerate(standings)
        if not nameable(one.best.extension)
    ]
    return AttitudeExplained(findings, fit, last, tuple(said))


def space_beside(recordings: Sequence[Recording], board: str) -> AttitudeSpace:
    """Return the space beside the base model's fit, for a question of one's own.

    Args:
        recordings: each with a reference attitude.
        board: in each of them.

    Raises:
        InputError: the board is not there, or gyro and reference hardly overlap.
    """
    return _space(_loaded(recordings, board))[0]


def _loaded(recordings: Sequence[Recording], board: str) -> list[Beside]:
    loaded = [(r, load_samples(r, board)) for r in recordings]
    settings = settings_of([(r, s, None) for r, s in loaded])
    return [
        Beside(r.path.name, s, reference_of(r, s), setting)
        for (r, s), setting in zip(loaded, settings, strict=True)
    ]


def _space(recordings: Sequence[Beside]) -> tuple[AttitudeSpace, Settled]:
    """Return the space beside the fit to some recordings, scores as wide as they vary."""
    settled = settle([(one.samples, one.reference) for one in recordings])
    read: list[tuple[FloatArray, FloatArray] | None] = []
    for one in recordings:
        force = one.samples.accel_m_s2
        read.append(None if force is None else (one.samples.time_s, force))
    space = AttitudeSpace.beside(settled, [one.setting for one in recordings], Forces(tuple(read)))
    groups = groups_of(space.scenes)
    return space.widened(np.sqrt(space.inflation([group.signal for group in groups]))), settled


def reference_of(recording: Recording, samples: GyroSamples) -> AttitudeReference:
    """Return a recording's attitudes on its samples' time axis.

    Raises:
        InputError: none of them can be used.
    """
    raw = recording.reference_attitude()
    time_s = np.asarray((times_ns(raw["host_time"]) - samples.origin_ns) * 1e-9, np.float64)
    return read_attitude(time_s, raw["orientation"], raw["standard_deviation"])


def gain_elsewhere(found: AttitudeSpace, recording: Beside) -> Gain | None:
    """Return what was found is worth on another recording: gain and causes as they are.

    Only bias and lag are the other recording's own, in both models. What is a recording's
    own (a step, a slip) is left out there. None where nothing is left.

    Raises:
        InputError: gyro and reference hardly overlap.
    """
    everything = list(enumerate(found.extensions))
    gone = [k for k, one in everything if one.term.scope == "recording"]
    named = [k for k, one in everything if k not in gone and nameable(one)]
    if not named:
        return None
    there, _ = _space([recording])
    left = []
    for lacking in ([*gone, *named], gone):
        gain = found.gain + found.best_step(lacking)[:9].reshape(3, 3)
        left.append(there.judged(gain, [one for k, one in everything if k not in lacking]))
    windows = there.windows(WINDOW_S)
    names = ", ".join(found.extensions[k].term.cause for k in gone)
    how = f"the recording {recording.name}, to which bias and time offset alone were fitted"
    if names:
        how += f"; left out there, for what it was in the other recording only: {names}"
    return gain_of(there, windows, how, *left)


def _unexplained(
    standings: Sequence[Standing], left: Sequence[Signature], tests: int
) -> Unexplained | None:
    nameless = [
        Signature(
            one.best.extension.term.cause,
            WORDS[one.best.extension.term.cause],
            2.0 * one.best.won,
            one.best.extension.free.size,
            p_value(one.best, one.looks, tests),
        )
        for one in standings
        if not nameable(one.best.extension)
    ]
    odd = (*nameless, *(one for one in left if one.p_value < ALPHA))
    if not odd:
        return None
    won = sum(2.0 * max(s.best.won, 0.0) for s in standings if nameable(s.best.extension))
    rest = max(one.statistic - one.degrees_of_freedom for one in odd)
    return Unexplained(odd[0], odd[1:], won / (won + rest) if won > 0.0 else 0.0)


def _nameless(one: Standing, gain: Gain | None) -> str:
    """Say what a signature without a cause amounts to."""
    extension = one.best.extension
    names = value_names(extension.term)
    own = ", ".join(
        f"{names[k]} {extension.values[k]:.3g} +- {s:.2g}"
        for k, s in zip(extension.free, one.best.std, strict=True)
    )
    worth = ""
    if gain is not None:
        nats = gain.log_likelihood
        worth = f"; {nats.value:.1f} nats ({nats.low:.1f} to {nats.high:.1f}) on data left out"
    unit = extension.term.parameters[0].unit
    return f"without a name: {extension.term.sentence(extension.values)} ({own} {unit}{worth})"


def _board(settled: Settled, fit: GyroFit) -> Board:
    """Return the calibration of a fit, in the shape that changes are told in."""
    factors = factorise(settled.work.gain)
    turn = np.eye(13)
    turn[:9, :9] = factor_jacobian(factors)
    values = np.concatenate([factors.as_vector(), settled.work.estimate[9:]])
    names = [f"{g}.{p}" for g, ps in _GROUPS for p in ps] + ["time_offset"]
    std = np.array([fit.std.get(name, np.nan) for name in names])
    return Board(values, std, turn)


_GROUPS = (
    ("scale", "xyz"),
    ("nonorthogonality", ("xy", "zx", "zy")),
    ("misalignment", "xyz"),
    ("bias", "xyz"),
)


def _moved(last: AttitudeSpace, first: AttitudeSpace, board: Board) -> FloatArray:
    """Return how far the named causes move the calibration, (13,)."""
    if not last.extensions:
        return np.zeros(13)
    step = last.best_step()[: first.board] - first.best_step()
    return board.moved(own_part(step, first.recordings))


def _named(
    space: AttitudeSpace, k: int, one: Standing, board: Board, tests: int, gain: Gain | None
) -> NamedCause:
    best, extension = one.best, space.extensions[k]
    term = extension.term
    std = np.full(extension.values.size, np.inf)
    std[extension.free] = best.std
    values = tuple(
        Value(name, float(value), float(s), p.unit, p.typical)
        for name, value, s, p in zip(
            value_names(term), extension.values, std, value_parameters(term), strict=True
        )
    )
    names, total = [], one.posterior
    for rival, share in one.rivals:
        if total >= STATED:
            break
        names.append(rival.extension.term.cause)
        total += share
    left_out = own_part(best.taken, space.recordings)
    return NamedCause(
        term=term,
        where=_where(term, extension, std),
        extension=extension,
        values=values,
        statistic=2.0 * max(best.won, 0.0),
        degrees_of_freedom=sum(j in indices(term, role="size") for j in extension.free),
        p_value=p_value(best, one.looks, tests),
        posterior=one.posterior,
        one_of=tuple(names),
        rivals=rivals_of(best, one.rivals),
        changes=board.changes(board.values + board.moved(left_out)),
        gain=gain,
    )


def _where(term: Term, extension: Extension, std: FloatArray) -> tuple[str, ...]:
    strength = {
        place: max(abs(float(extension.values[j])) / std[j] for j in indices(term, place, "size"))
        for place in places(term)
    }
    some = tuple(place for place, sigma in strength.items() if sigma > SHOWN_SIGMA)
    return some or tuple(sorted(strength, key=lambda p: -strength[p])[:1])
