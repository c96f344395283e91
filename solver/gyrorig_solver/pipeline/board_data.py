"""One board's recordings and samples, loaded once for every step of the pipeline.

What to use when: `load_board` from recordings; `reference_kinds` for the kinds of references,
which are the modules of `pipeline.references` that have a `KIND`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING

import numpy as np

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.module_registry import registered_modules
from gyrorig_protocol.recording.recording import Recording, in_order_of_time
from gyrorig_protocol.recording.recording_names import distinct_names
from gyrorig_solver.data.link_remedies import STUCK_SENSOR
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.data.stream.exact_repeats import without_repeats
from gyrorig_solver.data.stream.stuck_axes import (
    CLIPPING_REMEDY,
    require_changing_axes,
    without_clipping,
)
from gyrorig_solver.pipeline import references
from gyrorig_solver.pipeline.one_board import check_same_board
from gyrorig_solver.pipeline.rest_check import check_rests
from gyrorig_solver.reference import ReferenceMotion, TurnReference, read_turns

if TYPE_CHECKING:  # the kinds of references use the data of a board
    from gyrorig_solver.pipeline.reference_kind import ReferenceKind

UNIT_TOPIC = "/ptu/position"
PIECE_SAMPLES = 1000  # samples per comparison
Session = tuple[Recording, GyroSamples, ReferenceMotion]


@dataclass(frozen=True, eq=False)
class BoardData:
    """A board's recordings in the order of time, and the data that were read from each."""

    board: str
    recordings: tuple[Recording, ...]
    samples: tuple[GyroSamples, ...]  # as recorded
    # Replaces the sessions of `samples` if a known part of the rates was subtracted.
    changed_sessions: tuple[Session, ...] | None = None
    allows_contradiction: bool = False  # between the recordings, at the user's request
    # Remarks of the comparison of the recordings; None if they were not compared.
    comparison: tuple[str, ...] | None = None

    @cached_property
    def kind(self) -> "ReferenceKind":
        """The kind of reference with which the recordings are solved.

        Raises:
            InputError: there is no reference of any kind.
        """
        return find_reference(self)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The file name of each recording, with folders where names are equal."""
        return distinct_names(self.recordings)

    @property
    def missing(self) -> tuple[str, ...]:
        """Texts on missing or contradictory entries of the recordings, and on missing dates."""
        named = list(zip(self.names, self.recordings, strict=True))
        losses = tuple(f"{name}: {loss.text}" for name, r in named for loss in r.losses)
        losses = (*(self.comparison or ()), *losses)
        undated = [name for name, r in named if not r.has_time_of_day]
        if len(self.recordings) == 1 or not undated:
            return losses
        return (
            *losses,
            f"the time of day of {', '.join(undated)} is not known, so the order of the recordings "
            "is that in which they were given; figures show them one after the other, with a gap",
        )

    @cached_property
    def known_turns(self) -> tuple[TurnReference, ...]:
        """The known turns and rests of each recording.

        Raises:
            InputError: the text of a turn is not valid, or the board moves in a rest.
        """
        return tuple(
            read_checked_turns(recording, samples)
            for recording, samples in zip(self.recordings, self.samples, strict=True)
        )

    @cached_property
    def unclipped_samples(self) -> tuple[GyroSamples, ...]:
        """The samples of each recording; clipped ones are not usable.

        Raises:
            InputError: no sample of a recording is usable, or an axis did not measure.
            UsageError: the board's settings differ between recordings, or a recording is given
                twice.
        """
        self.check_recordings()
        return tuple(_require_usable(without_clipping(samples)) for samples in self.samples)

    @cached_property
    def sessions(self) -> tuple[Session, ...]:
        """Each recording with its samples and its reference motion.

        Exact repeats and clipped samples are marked as not usable.

        Raises:
            InputError: no sample of a recording is usable, or an axis did not measure.
            UsageError: a reference does not give the rate at each time, the board's settings differ
                between recordings, or a recording is given twice.
        """
        if self.changed_sessions is not None:
            return self.changed_sessions
        self.check_recordings()
        usable = [
            _require_usable(without_clipping(without_repeats(samples))) for samples in self.samples
        ]
        return tuple(
            (recording, samples, reference_motion(recording, samples))
            for recording, samples in zip(self.recordings, usable, strict=True)
        )

    def check_recordings(self) -> None:
        """Check that each recording is given once, and that all are of one board and its settings.

        Raises:
            UsageError: a recording is given twice, or the recordings are of two boards, or the
                board's settings differ.
        """
        check_given_once(self.recordings)
        check_same_board(self.board, self.names, [samples.metadata for samples in self.samples])


def load_board(
    recordings: Sequence[Recording], board: str, allow_contradiction: bool = False
) -> BoardData:
    """Load one board's samples from all of its recordings.

    Args:
        recordings: in any order.
        board: in each of them.
        allow_contradiction: fit the recordings together even if their gains differ.

    Raises:
        InputError: a recording lacks the board or has too few samples of it, or all samples are
            equal.
    """
    ordered = in_order_of_time(recordings)
    samples = tuple(load_changing_samples(r, board) for r in ordered)
    return BoardData(board, ordered, samples, allows_contradiction=allow_contradiction)


def load_changing_samples(recording: Recording, board: str) -> GyroSamples:
    """Load one board's samples from one recording.

    Raises:
        InputError: the recording lacks the board or has too few samples of it, or all samples are
            equal.
    """
    samples = load_samples(recording, board)
    counts = samples.counts
    for first in range(0, len(counts), PIECE_SAMPLES):
        if np.any(counts[first : first + PIECE_SAMPLES] != counts[:1]):
            return samples
    raise InputError(
        f"all {len(counts)} samples of board {board} in the recording {recording.path.name} are "
        "equal, so the sensor did not measure",
        STUCK_SENSOR.for_link(samples.link),
    )


def _require_usable(samples: GyroSamples) -> GyroSamples:
    """Return samples if one of them is usable and each axis measured.

    Raises:
        InputError: all samples are clipped, saturated or repeated, or an axis keeps one value while
            another axis turns.
    """
    require_changing_axes(samples)
    if samples.usable.any():
        return samples
    limit_dps = math.degrees(float(np.abs(samples.counts).max()) * samples.gyro.scale)
    raise InputError(
        f"none of the {samples.usable.size} samples of board {samples.board} is usable: they stay "
        f"at the end of the sensor's range, {limit_dps:.4g} deg/s, or repeat the sample before",
        CLIPPING_REMEDY,
    )


def read_checked_turns(recording: Recording, samples: GyroSamples) -> TurnReference:
    """Return the known turns and rests of a recording.

    Raises:
        InputError: the text of a turn is not valid, or the board moves in a rest.
    """
    known_turns = read_turns(recording.events(), samples.origin_ns)
    check_rests(recording, samples, known_turns.rests)
    return known_turns


def has_unit(recordings: Sequence[Recording]) -> bool:
    """Return whether a recording has the motion of a pan-tilt unit."""
    return any(UNIT_TOPIC in recording.topics for recording in recordings)


def reference_motion(recording: Recording, samples: GyroSamples) -> ReferenceMotion:
    """Read the motion of a recording whose reference gives the rate at each time.

    Raises:
        UsageError: the recording has no such reference.
    """
    motions = (kind.read_motion(recording, samples) for kind in reference_kinds())
    motion = next((motion for motion in motions if motion is not None), None)
    if motion is None:
        raise UsageError(
            f"the recording {recording.path.name} has no pan-tilt unit, and its board moves, so "
            "its data do not give the rate of the board at each moment",
            f"leave out {recording.path.name}, or use it separately",
        )
    return motion


def check_given_once(recordings: Sequence[Recording]) -> None:
    """Raise an error if a recording is given twice.

    Raises:
        UsageError: two of the recordings have the same content.
    """
    by_digest: dict[str, Recording] = {}
    if len(recordings) < 2:
        return
    for recording in recordings:
        twin = by_digest.setdefault(recording.sha256, recording)
        if twin is not recording:
            name, other_name = twin.path.name, recording.path.name
            raise UsageError(
                f"the recording {name} is given twice"
                if name == other_name
                else f"the files {name} and {other_name} contain the same recording",
                "give each recording once, because data that count twice make the uncertainties "
                "too small",
            )


@cache
def reference_kinds() -> "tuple[ReferenceKind, ...]":
    """Return every kind of reference, the preferred one first."""
    modules = registered_modules(references, "references")
    kinds: list[ReferenceKind] = [module.KIND for module in modules]
    return tuple(sorted(kinds, key=lambda kind: kind.preference))


def find_reference(data: BoardData) -> "ReferenceKind":
    """Return the preferred kind of the references that a board's recordings have.

    Raises:
        InputError: the recordings have no reference of any kind.
    """
    for kind in reference_kinds():
        if kind.is_given(data):
            return kind
    *others, last = [kind.title for kind in reference_kinds() if kind.is_suggested]
    names = ", ".join(data.names)
    raise InputError(
        f"the recording {names[:120]} has no reference to compare the rates with",
        f"record {', '.join(others)} or {last} too",
    )
