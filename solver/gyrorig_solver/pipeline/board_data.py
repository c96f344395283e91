"""One board's recordings and samples, loaded once for every step of the pipeline."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.data.stream.exact_repeats import without_repeats
from gyrorig_solver.data.stream.stuck_axes import without_clipping
from gyrorig_solver.reference import (
    ReferenceMotion,
    RestReference,
    TurnReference,
    mostly_at_rest,
    read_pan_tilt_reference,
    read_turns,
)

UNIT_TOPIC, ATTITUDE_TOPIC = "/ptu/position", "/reference/attitude"
Session = tuple[Recording, GyroSamples, ReferenceMotion]


@dataclass(frozen=True, eq=False)
class BoardData:
    """A board's recordings in the order of time, and what was read from each."""

    board: str
    recordings: tuple[Recording, ...]
    samples: tuple[GyroSamples, ...]  # as recorded

    @property
    def has_unit(self) -> bool:
        """Whether a recording has the motion of a pan-tilt unit."""
        return has_unit(self.recordings)

    @property
    def has_attitudes(self) -> bool:
        """Whether a recording has reference attitudes."""
        return any(ATTITUDE_TOPIC in recording.topics for recording in self.recordings)

    @cached_property
    def known_turns(self) -> tuple[TurnReference, ...]:
        """The known turns and rests of each recording."""
        return tuple(
            read_turns(recording.events(), samples.origin_ns)
            for recording, samples in zip(self.recordings, self.samples, strict=True)
        )

    @property
    def rests_throughout(self) -> bool:
        """Whether the board was at rest in all of its recordings, without another reference."""
        if self.has_unit or self.has_attitudes:
            return False
        return all(
            _is_at_rest(turns, samples)
            for turns, samples in zip(self.known_turns, self.samples, strict=True)
        )

    @property
    def can_be_searched(self) -> bool:
        """Whether causes can be searched: the reference gives a rate at each moment."""
        return self.has_unit or self.has_attitudes or self.rests_throughout

    @cached_property
    def sessions(self) -> tuple[Session, ...]:
        """Each recording with its samples and its reference motion.

        Exact repeats and clipped samples are marked as not usable.

        Raises:
            UsageError: a recording has neither a unit nor rest throughout, the board's settings
                differ between recordings, or a recording is given twice.
        """
        usable = tuple(without_clipping(without_repeats(samples)) for samples in self.samples)
        check_given_once(self.recordings)
        _check_same_settings(self.recordings, usable)
        return tuple(
            (recording, samples, reference_motion(recording, samples))
            for recording, samples in zip(self.recordings, usable, strict=True)
        )


def load_board(recordings: Sequence[Recording], board: str) -> BoardData:
    """Load one board's samples from all of its recordings.

    Raises:
        InputError: the board is not in a recording, or has too few samples there.
    """
    ordered = tuple(sorted(recordings, key=lambda recording: recording.start_ns))
    return BoardData(board, ordered, tuple(load_samples(r, board) for r in ordered))


def has_unit(recordings: Sequence[Recording]) -> bool:
    """Return whether a recording has the motion of a pan-tilt unit."""
    return any(UNIT_TOPIC in recording.topics for recording in recordings)


def reference_motion(recording: Recording, samples: GyroSamples) -> ReferenceMotion:
    """Read the reference of a recording that is fitted together with those of a unit.

    Raises:
        UsageError: the recording has neither a unit nor rest throughout.
    """
    if UNIT_TOPIC in recording.topics:
        return read_pan_tilt_reference(recording, samples.origin_ns)
    turns = read_turns(recording.events(), samples.origin_ns)
    if not _is_at_rest(turns, samples):
        raise UsageError(
            f"the recording {recording.path.name} has no pan-tilt unit, and its board moves, so "
            "the solver cannot use it together with recordings that have a unit",
            f"run `gyrorig solve` separately for {recording.path.name}",
        )
    return RestReference(turns.rests)


def _is_at_rest(turns: TurnReference, samples: GyroSamples) -> bool:
    return mostly_at_rest(turns.rests, float(samples.time_s[-1] - samples.time_s[0]))


def check_given_once(recordings: Sequence[Recording]) -> None:
    """Refuse a recording that is given twice.

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


def _check_same_settings(recordings: Sequence[Recording], samples: Sequence[GyroSamples]) -> None:
    first, *others = zip(recordings, samples, strict=True)
    for recording, other in others:
        for key in ("gyro_scale_rad_s", "gyro_full_scale_dps", "bandwidth_hz"):
            value, other_value = first[1].metadata.get(key), other.metadata.get(key)
            if value != other_value:
                raise UsageError(
                    f"the setting {key} of board {other.board} differs: it is "
                    f"{value or 'not given'} in the recording {first[0].path.name}, and "
                    f"{other_value or 'not given'} in {recording.path.name}",
                    "solve these two recordings separately",
                )
