"""The motion of a recording, for a replay."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.motion import RecordedExchange, RecordedMotion, RecordedPhase
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.motion_orders import AxisOrder, OrderAxis, OrderKind
from gyrorig_protocol.program import MotionProgram, PtuSettings, Rest, Step, parse_program
from gyrorig_protocol.ptu import MotionTranslator
from gyrorig_protocol.recording.messages import CommandCode, EventKind
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording, times_ns

PROGRAM_NAME = "program.yaml"
_SETTINGS = (OrderKind.BASE_SPEED, OrderKind.ACCELERATION)
_MOVES = (OrderKind.TARGET, OrderKind.OFFSET, OrderKind.RATE)
_UNSIGNED = (OrderKind.SPEED, OrderKind.BASE_SPEED, OrderKind.ACCELERATION)
_KINDS = {int(kind): kind for kind in OrderKind}
_AXES = {int(axis): axis for axis in OrderAxis}
_AXIS_NAMES = {OrderAxis.PAN: "pan", OrderAxis.TILT: "tilt"}
_ARCSEC_RAD = math.pi / (180.0 * 3600.0)
_LONGEST_PROGRAM_S = 86_400.0
_LEAD_NS = 500_000_000  # from the first sample to the begin of a program


@dataclass(frozen=True, slots=True)
class TimedOrder:
    """An order that the unit accepted, in steps of the recorded unit."""

    request_ns: int
    order: AxisOrder
    value: float  # in rad, rad/s or rad/s^2; NaN if the recording does not have it


@dataclass(frozen=True, slots=True)
class ReplaySource:
    """A recording to replay.

    Attributes:
        motion: its orders and phases.
        program: only its settings matter.
        program_text: the program of the recording, empty if it has none.
        sha256: checksum of the recording.
    """

    motion: RecordedMotion
    program: MotionProgram
    program_text: bytes
    sha256: str


def read_replay(path: Path) -> ReplaySource:
    """Return what a replay needs of a recording.

    Raises:
        InputError: the recording cannot be read, or no unit moves in it.
        MachineError: this computer cannot read it.
    """
    recording = read_recording(path)
    orders = list(_orders(recording))
    first_move_ns = next((o.request_ns for o in orders if o.order.kind in _MOVES), None)
    if first_move_ns is None or not recording.board_ids:
        raise InputError(
            f"{path} cannot be replayed, because no unit moves in it",
            "give a recording in which a pan-tilt unit moves",
        )
    begin_ns, end_ns = _program_span_ns(recording, first_move_ns)
    text = next((a.data for a in recording.attachments if a.name == PROGRAM_NAME), b"")
    settings = _program_settings(text)
    rad_per_step = _rad_per_step(recording, orders)
    # An emulated unit needs 3 s for each of these settings, as a real one does. Within the program
    # of a faster unit, they would delay its first move.
    before = [o for o in orders if o.request_ns < first_move_ns and o.order.kind in _SETTINGS]
    orders = [o for o in orders if o not in before]
    motion = RecordedMotion(
        name=path.name,
        # The settings of a program are sent before it, as for any program.
        settings=() if settings is not None else tuple(_si(o, rad_per_step) for o in before),
        exchanges=tuple(
            RecordedExchange(request_ns - begin_ns, tuple(_si(o, rad_per_step) for o in group))
            for request_ns, group in _by_exchange(orders)
            if begin_ns <= request_ns < end_ns
        ),
        phases=tuple(
            RecordedPhase(
                event.host_time_ns - begin_ns,
                event.kind == EventKind.PHASE_BEGIN,
                event.phase,
                event.text,
            )
            for event in recording.events()
            if event.kind in (EventKind.PHASE_BEGIN, EventKind.PHASE_END)
            and event.phase != "program"
            and begin_ns <= event.host_time_ns <= end_ns
        ),
        duration_ns=end_ns - begin_ns,
        lead_ns=begin_ns - _first_sample_ns(recording),
    )
    seconds = min(motion.duration_ns * 1e-9, _LONGEST_PROGRAM_S)
    program = MotionProgram(
        name=f"replay of {path.name}",
        steps=(Step(rest=Rest(seconds=seconds)),),
        settings=settings or PtuSettings(),
    )
    return ReplaySource(motion, program, bytes(text), recording.sha256)


def _orders(recording: Recording) -> Iterator[TimedOrder]:
    """Yield the accepted orders, from the verbatim commands in an old recording."""
    raw = recording.motion_orders()
    if raw.size == 0:
        translator = MotionTranslator()
        for command in recording.ptu_commands():
            accepted = command.code == CommandCode.OK
            for order in translator.translate(command.command, accepted):
                if accepted:
                    yield TimedOrder(command.request_time_ns, order, math.nan)
        return
    for request_ns, row in zip(times_ns(raw["request_time"]).tolist(), raw, strict=True):
        kind, axis = _KINDS.get(int(row["kind"])), _AXES.get(int(row["axis"]))
        if row["accepted"] and kind is not None and axis is not None:
            order = AxisOrder(kind, axis, float(row["steps"]), float(row["speed_steps"]))
            yield TimedOrder(request_ns, order, float(row["value"]))


def _by_exchange(orders: list[TimedOrder]) -> Iterator[tuple[int, list[TimedOrder]]]:
    """Yield the orders with the same time of request together."""
    groups: dict[int, list[TimedOrder]] = {}
    for order in orders:
        groups.setdefault(order.request_ns, []).append(order)
    yield from sorted(groups.items())


def _program_span_ns(recording: Recording, first_move_ns: int) -> tuple[int, int]:
    """Return begin and end of the program; those of the recording if it has no phases.

    If the first sample is later than the begin, the program begins after it, or with its first
    move. A replay records before its program begins, and the begin of a recording takes some time.
    """
    begins, ends = (
        [e.host_time_ns for e in recording.events() if e.phase == "program" and e.kind == kind]
        for kind in (EventKind.PHASE_BEGIN, EventKind.PHASE_END)
    )
    first_sample_ns = _first_sample_ns(recording)
    begin_ns = begins[0] if begins else 0
    if begin_ns < first_sample_ns:
        begin_ns = first_sample_ns + _LEAD_NS
    end_ns = ends[-1] if ends else recording.end_ns
    return min(begin_ns, first_move_ns), max(end_ns, first_move_ns + 1)


def _first_sample_ns(recording: Recording) -> int:
    return min(int(recording.imu_field(board, "host_time")[0]) for board in recording.board_ids)


def _program_settings(text: bytes) -> PtuSettings | None:
    if not text:
        return None
    try:
        return parse_program(text, PROGRAM_NAME).settings
    except UsageError:  # a newer or an unusual program; the recorded settings are sent
        return None


def _rad_per_step(recording: Recording, orders: list[TimedOrder]) -> dict[OrderAxis, float]:
    """Return the signed angle of a step of each axis, nominal."""
    metadata = recording.metadata.get("gyrorig.ptu", {})
    sizes: dict[OrderAxis, float] = {}
    for axis, name in _AXIS_NAMES.items():
        known = [
            o.value / o.order.value
            for o in orders
            if o.order.axis is axis and o.order.kind in _MOVES and o.order.value
        ]
        finite = [size for size in known if math.isfinite(size) and size]
        stated = float(metadata.get(f"{name}_resolution_arcsec", "nan")) * _ARCSEC_RAD
        sizes[axis] = finite[0] if finite else stated
    return sizes


def _si(timed: TimedOrder, rad_per_step: dict[OrderAxis, float]) -> AxisOrder:
    """Return an order with its values in rad, rad/s or rad/s^2.

    Raises:
        InputError: the recording does not have the size of a step.
    """
    order = timed.order
    size_rad = rad_per_step.get(order.axis)
    if size_rad is None:
        return order
    if not math.isfinite(size_rad):
        raise InputError(
            "the recording cannot be replayed, because it does not have the size of a step",
            "give a recording with the resolution of its unit",
        )
    value = order.value * (abs(size_rad) if order.kind in _UNSIGNED else size_rad)
    return AxisOrder(order.kind, order.axis, value, order.speed_steps_s * abs(size_rad))
