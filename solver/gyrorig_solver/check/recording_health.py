"""Health of a recording: its content, its defects, and the observable parameters.

What to use when: `examine_recording` for all of it; `health_messages` converts it to text.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.mcap.losses import Loss
from gyrorig_protocol.recording.messages import EventKind, PtuStatus, imu_raw_topic
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.check.attitude_health import AttitudeHealth, examine_attitudes
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.data.stream.count_stream import CountStream, StreamFinding
from gyrorig_solver.data.stream.stuck_axes import check_stuck_axes
from gyrorig_solver.estimate import ObservabilityReport
from gyrorig_solver.pipeline import BoardData
from gyrorig_solver.pipeline.board_data import load_changing_samples
from gyrorig_solver.reference import UNUSABLE_STATUS


@dataclass(frozen=True, slots=True)
class BoardHealth:
    """One board: its samples, its clock, and the observable parameters."""

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
    observability: ObservabilityReport | None  # None: it cannot be calibrated from this alone
    no_reference: str = ""  # the reason for that
    fault: str = ""  # why the board cannot be used
    clock_steps: int = 0  # of its clock or the host's, without a restart
    link: str = "serial"  # as in the metadata of the board
    attitudes: AttitudeHealth | None = None  # the reference attitudes, on the board's time axis
    still_axes: tuple[StreamFinding, ...] = ()  # axes that are stuck or clipped


@dataclass(frozen=True, slots=True)
class UnitHealth:
    """The pan-tilt unit: positions and commands."""

    polls: int
    poll_rate_hz: float
    unsynchronised: int
    pan_deg: tuple[float, float]
    tilt_deg: tuple[float, float]
    commands: int
    refused: int  # answered with an error, or not answered


@dataclass(frozen=True, slots=True)
class RecordingHealth:
    """Health of a recording."""

    name: str
    complete: bool
    losses: tuple[Loss, ...]
    notes: tuple[str, ...]
    duration_s: float
    topics: dict[str, int]
    dropped: dict[str, int]  # messages missing by the daemon's count, by topic
    phases: dict[str, int]
    faults: tuple[str, ...]  # noted by the daemon
    unit: UnitHealth | None
    boards: tuple[BoardHealth, ...]

    @property
    def identifiable(self) -> bool:
        """True when every board can be calibrated in full."""
        return bool(self.boards) and all(
            board.observability is not None and not board.observability.unobservable
            for board in self.boards
        )


def examine_recording(recording: Recording, wanted: tuple[BoardId, ...]) -> RecordingHealth:
    """Return the health of a recording and of the requested boards."""
    events = recording.events()
    return RecordingHealth(
        name=recording.path.name,
        complete=recording.is_complete,
        losses=tuple(recording.losses),
        notes=recording.notes,
        duration_s=(recording.end_ns - recording.start_ns) * 1e-9,
        topics={name: len(topic) for name, topic in sorted(recording.topics.items())},
        dropped={name: t.missing_count for name, t in recording.topics.items() if t.missing_count},
        phases=dict(Counter(e.phase for e in events if e.kind == EventKind.PHASE_BEGIN)),
        faults=tuple(e.text for e in events if e.kind == EventKind.FAULT),
        unit=_unit_health(recording),
        boards=tuple(_board_health(recording, board) for board in wanted),
    )


def _unit_health(recording: Recording) -> UnitHealth | None:
    polls = recording.ptu_positions()
    if not polls.size:
        return None
    synchronised = polls[polls["status"] & UNUSABLE_STATUS == 0]
    poll_times = times_ns(polls["reply_time"])
    span_s = max(float(poll_times[-1] - poll_times[0]) * 1e-9, 1e-9)
    commands = recording.ptu_commands()
    return UnitHealth(
        polls=int(polls.size),
        poll_rate_hz=(polls.size - 1) / span_s,
        unsynchronised=int(np.sum(polls["status"] & PtuStatus.SYNCHRONY_LOST != 0)),
        pan_deg=_range_deg(synchronised["pan"]),
        tilt_deg=_range_deg(synchronised["tilt"]),
        commands=len(commands),
        refused=sum(command.code != 0 for command in commands),
    )


def _range_deg(angle_rad: np.ndarray) -> tuple[float, float]:
    if not angle_rad.size:
        return 0.0, 0.0
    return float(np.degrees(angle_rad.min())), float(np.degrees(angle_rad.max()))


def _board_health(recording: Recording, board: BoardId) -> BoardHealth:
    metadata = recording.metadata.get(f"gyrorig.board.{board}", {})
    sensor = " ".join(metadata.get("sensor", "").split())  # untrusted: no line breaks
    try:
        samples = load_changing_samples(recording, board)
    except GyrorigError as fault:
        count = len(recording.topics[imu_raw_topic(board)])
        return BoardHealth(
            str(board), sensor, count, *(0.0, 0.0), *(0, 0, 0, 0), *(0.0, 0.0, 0.0), 0, None,
            fault=_error_with_remedy(fault),
        )  # fmt: skip
    observability, no_reference = _observability(recording, samples)
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
        saturated=max(0, int(np.sum(~samples.usable)) - samples.repeated),
        restarts=clock.restarts,
        skew_ppm=clock.skew_ppm,
        latency_median_s=float(clock.latency_s[0]),
        latency_max_s=float(clock.latency_s[2]),
        clock_pings=int(recording.clock_pings(board).size),
        observability=observability,
        no_reference=no_reference,
        clock_steps=clock.steps,
        link=samples.link,
        attitudes=examine_attitudes(recording, samples),
        still_axes=tuple(
            finding
            for result in check_stuck_axes(CountStream(samples))
            for finding in result.findings
        ),
    )


def _observability(
    recording: Recording, samples: GyroSamples
) -> tuple[ObservabilityReport | None, str]:
    """Return the observability; or None, and why this recording alone calibrates nothing."""
    try:
        data = BoardData(samples.board, (recording,), (samples,))
        return data.kind.determine_observability(data), ""
    except GyrorigError as fault:
        return None, _error_with_remedy(fault)


def _error_with_remedy(fault: GyrorigError) -> str:
    """Return the text of an error, always with a remedy."""
    return str(fault) if fault.remedy else f"{fault}. Record again."
