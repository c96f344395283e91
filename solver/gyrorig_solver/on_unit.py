"""A board on a pan-tilt unit, or lying still: from its recordings to a fit.

What to use when: `begun` for what is then fitted, alone (`Begun.solution`) or with other boards
(`together`), and concluded; `unit_solution` and `unit_session` where causes are looked for.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.estimate.motion import concluded, session_of, solution_of
from gyrorig_solver.estimate.result import GyroFit, StageLevel
from gyrorig_solver.estimate.session import SessionFit
from gyrorig_solver.extensions import Chosen, choose_extensions
from gyrorig_solver.model.terms.level_rests import level_by_rests
from gyrorig_solver.raw.repeats import without_repeats
from gyrorig_solver.reference.motion import ReferenceMotion
from gyrorig_solver.reference.ptu import PtuReference
from gyrorig_solver.reference.ptu_recording import ptu_reference
from gyrorig_solver.reference.rest import RestReference, mostly_at_rest
from gyrorig_solver.reference.turns import read_turns
from gyrorig_solver.samples import GyroSamples, load_samples
from gyrorig_solver.setting import settings_of

PTU_WORDS = {
    "x": "tilt was not moved; move tilt at a few speeds",
    "y": "pan was swept at one tilt only, or not at all; sweep it at +T and at -T",
    "z": "pan was not moved, or at one steep tilt only; sweep it at +T and at -T",
    "bias": "there are too few samples; record at rest for a minute",
    "time_offset": "nothing was accelerated; move and stop a few times",
}
MOST_FOR_LEVEL = 4_000_000  # samples: hours of accelerations are not worth their memory


@dataclass(frozen=True, slots=True, eq=False)
class Begun:
    """A board on a unit, with all that its fit needs and its result will say."""

    found: list[tuple[Recording, GyroSamples, ReferenceMotion]]
    chosen: Chosen
    warnings: tuple[str, ...]

    def solution(self) -> Solution:
        """Fit it by itself."""
        pairs = [(samples, reference) for _, samples, reference in self.found]
        return solution_of(pairs, self.chosen.extensions, self.chosen.settings)

    def concluded(
        self,
        solution: Solution,
        warnings: Sequence[str] = (),
        more: Mapping[str, float] | None = None,
    ) -> GyroFit:
        """Return what may be said of it."""
        samples = [samples for _, samples, _ in self.found]
        words = {**PTU_WORDS, **self.chosen.words}
        said = (*self.warnings, *self.chosen.remarks, *warnings)
        fit = concluded(solution, samples, words, said, more)
        return replace(fit, level=level_of(*self.found[-1][1:]))


def begun(
    loaded: list[tuple[Recording, GyroSamples]],
    extend: Sequence[str] = (),
    named: Sequence[Extension] = (),
) -> Begun:
    """Return a board on a unit, or at rest, ready to be fitted.

    Args:
        loaded: its recordings in the order of time, and its samples.
        extend: causes of the catalogue to fit beside the base model.
        named: causes as a search named them.

    Raises:
        InputError: there is no reference.
        UsageError: recordings that cannot be solved together, or an unknown cause.
    """
    loaded = [(recording, without_repeats(samples)) for recording, samples in loaded]
    _check_alike(loaded)
    found: list[tuple[Recording, GyroSamples, ReferenceMotion]] = []
    warnings: tuple[str, ...] = ()
    for recording, samples in loaded:
        reference, said = _motion_of(recording, samples)
        found.append((recording, samples, reference))
        many = f"{recording.path.name}: " if len(loaded) > 1 else ""
        warnings += tuple(many + text for text in said)
    return Begun(found, choose_extensions(found, extend, named), warnings)


def unit_solution(recordings: Sequence[Recording], board: str) -> Solution:
    """Fit the base model to one board's recordings on a unit, or all at rest.

    Returns where the fit ended. Every recording's setting is put in, and the Earth's rotation
    where the site is known: causes can be looked for from here.

    Args:
        recordings: in any order.
        board: in each of them.

    Raises:
        InputError: the board is not there.
        UsageError: recordings that cannot be fitted together, or in which a board moved
            without a unit.
    """
    ordered = sorted(recordings, key=lambda recording: recording.start_ns)
    if not rests_throughout(ordered, board):
        _check_unit(ordered)
    loaded = [(one, without_repeats(load_samples(one, board))) for one in ordered]
    _check_alike(loaded)
    found = [(r, samples, _motion_of(r, samples)[0]) for r, samples in loaded]
    chosen = choose_extensions(found, ())
    settings = chosen.settings or settings_of(found)
    return solution_of([(s, m) for _, s, m in found], chosen.extensions, settings)


def rests_throughout(recordings: Sequence[Recording], board: str) -> bool:
    """Return whether a board lay still in all of its recordings, without a unit.

    Raises:
        InputError: the board is not there.
    """
    topics = {topic for recording in recordings for topic in recording.topics}
    if topics & {"/ptu/position", "/reference/attitude"}:
        return False
    loaded = [(one, load_samples(one, board)) for one in recordings]
    return all(
        mostly_at_rest(
            read_turns(one.events(), samples.origin_ns).rests,
            float(samples.time_s[-1] - samples.time_s[0]),
        )
        for one, samples in loaded
    )


def unit_session(
    recording: Recording,
    board: str,
    mean_degc: float | None = None,
    samples: GyroSamples | None = None,
) -> SessionFit:
    """Return a recording of a board on a unit, ready for a model that was fitted elsewhere.

    Args:
        recording: of a unit.
        board: in it.
        mean_degc: what the model's temperatures count from.
        samples: taken instead of the recording's own.

    Raises:
        InputError: the board is not there, or too few samples are.
        UsageError: the recording is none of a unit.
    """
    _check_unit([recording])
    own = without_repeats(load_samples(recording, board) if samples is None else samples)
    motion, _ = _motion_of(recording, own)
    (setting,) = settings_of([(recording, own, motion)], mean_degc)
    return session_of(own, motion, setting)


def _check_unit(recordings: Sequence[Recording]) -> None:
    """Refuse what is no recording of a unit.

    Raises:
        UsageError: none of them is.
    """
    if not any("/ptu/position" in r.topics for r in recordings):
        raise UsageError(
            f"no recording of {', '.join(r.path.name for r in recordings)[:120]} has a pan-tilt "
            "unit in it, on which what a model gets wrong is looked for",
            "record the board on one",
        )


def level_of(samples: GyroSamples, reference: ReferenceMotion) -> StageLevel | None:
    """Return how the accelerometer sees the stage stand, None where it cannot tell."""
    if not isinstance(reference, PtuReference) or samples.number.size > MOST_FOR_LEVEL:
        return None
    accel = samples.accel_m_s2
    if accel is None:
        return None
    try:
        found = level_by_rests(samples.time_s, accel, reference.angles_rad(samples.time_s))
    except InputError:  # too few tilts: that is no fault of the recording
        return None
    right, forward = (float(v) for v in found.lean_rad)
    right_std, forward_std = (float(v) for v in found.lean_std_rad)
    return StageLevel(
        tilt_zero_rad=found.offset_rad,
        tilt_zero_std_rad=found.offset_std_rad,
        lean_rad=(right, forward),
        lean_std_rad=(right_std, forward_std),
        rests=found.rests,
    )


def _motion_of(
    recording: Recording, samples: GyroSamples
) -> tuple[ReferenceMotion, tuple[str, ...]]:
    """Return the reference of one recording that is solved with a unit's, and its remarks."""
    if "/ptu/position" in recording.topics:
        reference = ptu_reference(recording, samples.origin_ns)
        return reference, reference.warnings
    found = read_turns(recording.events(), samples.origin_ns)
    if not mostly_at_rest(found.rests, float(samples.time_s[-1] - samples.time_s[0])):
        raise UsageError(
            f"{recording.path.name} has neither a unit nor rest throughout",
            "solve it apart from the recordings of a unit",
        )
    return RestReference(found.rests), ()


def _check_alike(loaded: list[tuple[Recording, GyroSamples]]) -> None:
    """Refuse to pool recordings of a board that was set differently, or one of them twice.

    Raises:
        UsageError: they differ in scale, full scale or low-pass, or are the same.
    """
    first, samples = loaded[0]
    known: dict[str, Recording] = {}
    for recording, _ in loaded:
        twin = known.setdefault(recording.sha256, recording) if len(loaded) > 1 else recording
        if twin is not recording:
            same = twin.path.name == recording.path.name
            raise UsageError(
                f"{twin.path.name} is named twice"
                if same
                else f"{twin.path.name} and {recording.path.name} are one recording",
                "name each once: evidence counted twice claims too much",
            )
    for recording, other in loaded[1:]:
        for key in ("gyro_scale_rad_s", "gyro_full_scale_dps", "bandwidth_hz"):
            one, two = samples.metadata.get(key), other.metadata.get(key)
            if one != two:
                raise UsageError(
                    f"{first.path.name} has {key} {one}, {recording.path.name} has {two}",
                    "solve recordings of different settings apart",
                )
