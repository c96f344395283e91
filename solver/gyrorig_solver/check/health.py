"""What is in a recording, and what is wrong with it, in numbers; `remarks` has the words."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.losses import Loss
from gyrorig_protocol.recording.messages import EventKind, PtuStatus, imu_topic
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.check.capability import capability
from gyrorig_solver.estimate.result import Observability
from gyrorig_solver.on_unit import PTU_WORDS
from gyrorig_solver.reference.ptu_recording import OUT_OF_STEP, ptu_reference
from gyrorig_solver.samples import GyroSamples, load_samples
from gyrorig_solver.solve import solve_recordings


@dataclass(frozen=True, slots=True)
class BoardHealth:
    """One board: its samples, its clock, and what its motion can show."""

    board: str
    sensor: str
    samples: int
    duration_s: float
    rate_hz: float
    lost: int  # by the board's own counter
    repeated: int
    saturated: int
    restarts: int
    skew_ppm: float
    latency_median_s: float
    latency_max_s: float
    clock_pings: int
    observability: Observability | None  # None: it cannot be calibrated by this alone
    no_reference: str = ""  # why it cannot
    fault: str = ""  # why the board cannot be used at all
    clock_steps: int = 0  # of its clock or the host's, while it ran on


@dataclass(frozen=True, slots=True)
class UnitHealth:
    """The pan-tilt unit's side."""

    polls: int
    poll_rate_hz: float
    unsynchronised: int
    pan_deg: tuple[float, float]
    tilt_deg: tuple[float, float]
    commands: int
    refused: int  # answered with an error, or not at all


@dataclass(frozen=True, slots=True)
class Health:
    """A whole recording."""

    name: str
    complete: bool
    losses: tuple[Loss, ...]
    notes: tuple[str, ...]
    duration_s: float
    topics: dict[str, int]
    dropped: dict[str, int]  # messages missing by the daemon's own count, by topic
    phases: dict[str, int]
    faults: tuple[str, ...]  # that the daemon noted
    unit: UnitHealth | None
    boards: tuple[BoardHealth, ...]

    @property
    def identifiable(self) -> bool:
        """True when every board can be calibrated in full."""
        return bool(self.boards) and all(
            board.observability is not None and not board.observability.unobservable
            for board in self.boards
        )


def examine(recording: Recording, wanted: tuple[BoardId, ...]) -> Health:
    """Return the health of a recording and of the boards that are wanted."""
    events = recording.events()
    return Health(
        name=recording.path.name,
        complete=recording.complete,
        losses=tuple(recording.losses),
        notes=recording.notes,
        duration_s=(recording.end_ns - recording.start_ns) * 1e-9,
        topics={name: len(topic) for name, topic in sorted(recording.topics.items())},
        dropped=_dropped(recording),
        phases=dict(Counter(e.phase for e in events if e.kind == EventKind.PHASE_BEGIN)),
        faults=tuple(e.text for e in events if e.kind == EventKind.FAULT),
        unit=_unit(recording),
        boards=tuple(_board(recording, board) for board in wanted),
    )


def _dropped(recording: Recording) -> dict[str, int]:
    """Return the gaps in the daemon's own count of each array topic."""
    return {name: topic.dropped for name, topic in recording.topics.items() if topic.dropped}


def _unit(recording: Recording) -> UnitHealth | None:
    polls = recording.ptu_positions()
    if not polls.size:
        return None
    good = polls[polls["status"] & OUT_OF_STEP == 0]
    at = times_ns(polls["reply_time"])
    span_s = max(float(at[-1] - at[0]) * 1e-9, 1e-9)
    commands = recording.ptu_commands()
    return UnitHealth(
        polls=int(polls.size),
        poll_rate_hz=(polls.size - 1) / span_s,
        unsynchronised=int(np.sum(polls["status"] & PtuStatus.SYNCHRONY_LOST != 0)),
        pan_deg=_range_deg(good["pan"]),
        tilt_deg=_range_deg(good["tilt"]),
        commands=len(commands),
        refused=sum(command.code != 0 for command in commands),
    )


def _range_deg(angle_rad: np.ndarray) -> tuple[float, float]:
    if not angle_rad.size:
        return 0.0, 0.0
    return float(np.degrees(angle_rad.min())), float(np.degrees(angle_rad.max()))


def _board(recording: Recording, board: BoardId) -> BoardHealth:
    sensor = recording.metadata.get(f"gyrorig.board.{board}", {}).get("sensor", "")
    try:
        samples = load_samples(recording, board)
    except GyrorigError as fault:
        count = len(recording.topics[imu_topic(board)])
        return BoardHealth(
            str(board), sensor, count, *(0.0, 0.0), *(0, 0, 0, 0), *(0.0, 0.0, 0.0), 0, None,
            fault=_told(fault),
        )  # fmt: skip
    seen, no_reference = _observability(recording, samples)
    duration_s = float(samples.time_s[-1] - samples.time_s[0])
    clock = samples.clock
    return BoardHealth(
        board=str(board),
        sensor=sensor,
        samples=int(samples.time_s.size),
        duration_s=duration_s,
        rate_hz=1.0 / samples.period_s if samples.period_s > 0.0 else 0.0,
        lost=samples.lost,
        repeated=samples.repeated,
        saturated=max(0, int(np.sum(~samples.good)) - samples.repeated),
        restarts=clock.restarts,
        skew_ppm=clock.skew_ppm,
        latency_median_s=float(clock.latency_s[0]),
        latency_max_s=float(clock.latency_s[2]),
        clock_pings=int(recording.clock_pings(board).size),
        observability=seen,
        no_reference=no_reference,
        clock_steps=clock.steps,
    )


def _observability(recording: Recording, samples: GyroSamples) -> tuple[Observability | None, str]:
    """Return what can be shown; or None, and why this recording alone calibrates nothing."""
    try:
        if recording.ptu_positions().size:
            reference = ptu_reference(recording, samples.origin_ns)
            return capability(samples, reference, PTU_WORDS), ""
        return solve_recordings([recording], samples.board).observability, ""
    except GyrorigError as fault:
        return None, _told(fault)


def _told(fault: GyrorigError) -> str:
    """Return what an error says, always with what to do."""
    return str(fault) if fault.remedy else f"{fault}: record again"
