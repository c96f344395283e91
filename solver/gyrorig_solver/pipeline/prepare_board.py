"""Prepare a board, with a reference that gives the rate at each time, for its fit.

What to use when: `prepare_board` for a calibration, of one board (`PreparedBoard.solve`) or
together with other boards (`criticised_fit`); `fit_base` for the fit from which the search for
causes starts; `prepare_held_out` for a recording on which a fitted model is tested.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.data.stream.exact_repeats import without_repeats
from gyrorig_solver.data.stream.stuck_axes import without_clipping
from gyrorig_solver.discover.held_out_recording import HeldOutRecording
from gyrorig_solver.estimate import (
    NO_SHARING,
    BoardSharing,
    ConvergedFit,
    FittedTerm,
    GyroFit,
    confirm_fit,
)
from gyrorig_solver.estimate.motion_fit import create_session, solve_motion, summarize_motion_fit
from gyrorig_solver.model import LevelEstimate, RecordingContext
from gyrorig_solver.model.leveling import level_from_rests
from gyrorig_solver.pipeline.board_data import BoardData, Session, reference_motion
from gyrorig_solver.pipeline.recording_contexts import read_contexts
from gyrorig_solver.pipeline.term_selection import TermSelection, select_terms
from gyrorig_solver.reference import PanTiltReference, ReferenceMotion
from gyrorig_solver.reference.unit.counted_reference import CountedReference

MAX_SAMPLES_FOR_LEVEL = 4_000_000  # more accelerations need too much memory


@dataclass(frozen=True, slots=True, eq=False)
class PreparedBoard:
    """A board's samples, references and selected terms, ready to be fitted."""

    sessions: Sequence[Session]
    selection: TermSelection
    contexts: Sequence[RecordingContext]
    remedies: Mapping[str, str]  # by what the motion may fail to show
    warnings: tuple[str, ...]

    def solve(self) -> ConvergedFit:
        """Fit the board without other boards."""
        pairs = [(samples, reference) for _, samples, reference in self.sessions]
        return confirm_fit(solve_motion(pairs, self.selection.extensions, self.contexts))

    def summarize(
        self,
        solution: ConvergedFit,
        warnings: Sequence[str] = (),
        sharing: BoardSharing = NO_SHARING,
    ) -> GyroFit:
        """Build the `GyroFit` of a converged fit: estimates, covariance and warnings."""
        samples = [samples for _, samples, _ in self.sessions]
        remedies = {**self.remedies, **self.selection.remedies}
        all_warnings = (*self.warnings, *self.selection.remarks, *warnings)
        fit = summarize_motion_fit(solution, samples, remedies, all_warnings, sharing)
        pairs = [(samples, reference) for _, samples, reference in self.sessions]
        return replace(fit, level=last_stage_level(pairs))


def prepare_board(
    data: BoardData, extend: Sequence[str] = (), named_terms: Sequence[FittedTerm] = ()
) -> PreparedBoard:
    """Prepare a board on a unit, or at rest.

    Raises:
        InputError: a recording has no reference.
        UsageError: the recordings cannot be solved together, or a cause is unknown.
    """
    warnings: list[str] = []
    for name, (_, _, reference) in zip(data.names, data.sessions, strict=True):
        prefix = f"{name}: " if len(data.sessions) > 1 else ""
        if isinstance(reference, PanTiltReference | CountedReference):
            warnings += [prefix + text for text in reference.warnings]
    selection = select_terms(data.sessions, extend, named_terms)
    contexts = selection.contexts or read_contexts(data.sessions)
    return PreparedBoard(data.sessions, selection, contexts, data.kind.remedies, tuple(warnings))


def fit_base(data: BoardData) -> ConvergedFit:
    """Fit the base model to a board on a unit, or at rest throughout.

    The fit has the contexts of the recordings, and includes the Earth's rotation if the site is
    known, so that causes can be searched from this fit.

    Raises:
        UsageError: the recordings cannot be fitted together, or a reference does not give the rate
            at each time.
    """
    return prepare_board(data).solve()


def prepare_held_out(
    recording: Recording,
    board: str,
    solution: ConvergedFit,
    samples: GyroSamples | None = None,
) -> HeldOutRecording:
    """Prepare a recording for models of the same board that were fitted to others.

    Args:
        recording: with a pan-tilt unit, or at rest.
        board: in it.
        solution: one of the models; temperatures are relative to its mean.
        samples: used instead of the samples of the recording.

    Raises:
        InputError: the board is not in the recording, or has too few samples.
        UsageError: the reference does not give the rate at each time.
    """
    context = solution.sessions[0].context
    temperature = None if context is None else context.temperature
    mean_degc = None if temperature is None else temperature.mean_degc
    loaded = load_samples(recording, board) if samples is None else samples
    usable = without_clipping(without_repeats(loaded))
    motion = reference_motion(recording, usable)
    (own_context,) = read_contexts([(recording, usable, motion)], mean_degc)
    return HeldOutRecording(create_session(usable, motion, own_context), recording.path.name)


def last_stage_level(
    recordings: Iterable[tuple[GyroSamples, ReferenceMotion]],
) -> LevelEstimate | None:
    """Return the stage's level in the last recording that shows it; None if none does."""
    levels = (_stage_level(*recording) for recording in reversed(list(recordings)))
    return next((level for level in levels if level is not None), None)


def _stage_level(samples: GyroSamples, reference: ReferenceMotion) -> LevelEstimate | None:
    """Estimate the stage's level from the accelerometer; None if it cannot be estimated."""
    if not isinstance(reference, PanTiltReference) or samples.number.size > MAX_SAMPLES_FOR_LEVEL:
        return None
    accel = samples.accel_m_s2
    if accel is None:
        return None
    try:
        return level_from_rests(samples.time_s, accel, reference.angles_rad(samples.time_s))
    except InputError:  # too few tilts; the recording itself is fine
        return None
