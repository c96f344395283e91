"""The unit and the boards of a rig file, as far as a prediction needs them.

The daemon's reader validates the whole file; this module reads the fields that a prediction needs.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from gyrorig_protocol.board import TimeReply, TimeRequest
from gyrorig_protocol.board_protocols import find_protocol
from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.profile import SensorProfile
from gyrorig_protocol.ptu import Dialect
from gyrorig_solver.model import STANDARD_GRAVITY_M_S2, Site
from gyrorig_solver.plan.sensor_model import SensorModel, build_sensor_model
from gyrorig_solver.plan.unit_model import BITS_PER_BYTE, AxisModel, UnitModel, build_unit_model

SCHEMA = "gyrorig/rig/1"
EMULATED = "emulated"
MANUAL = "manual"  # the driver of a rig that a person turns
# Units that `unit_model` describes: of this driver, and not of this dialect.
KNOWN_DRIVER, UNKNOWN_DIALECT = "directed_perception", "d48e"
DEFAULT_SENSOR = "L3G4200D"
Positive = Annotated[float, msgspec.Meta(gt=0.0)]


class RigLimits(msgspec.Struct, frozen=True):
    """Limits of the motion; None: those of the unit."""

    pan_min_deg: float | None = None
    pan_max_deg: float | None = None
    tilt_min_deg: float | None = None
    tilt_max_deg: float | None = None
    speed_deg_s: Positive | None = None


class _Polling(msgspec.Struct, frozen=True):
    rate_hz: Positive | None = None


class _Unit(msgspec.Struct, frozen=True):
    port: str
    driver: str = KNOWN_DRIVER
    baud: Annotated[int, msgspec.Meta(ge=300)] = 9600
    dialect: Literal["auto", "d46", "e46"] = "auto"
    pan_sign: Literal[-1, 1] = 1
    tilt_sign: Literal[-1, 1] = 1
    limits: RigLimits = RigLimits()
    poll: _Polling = _Polling()


class _Facts(msgspec.Struct, frozen=True):
    sensor: str | None = None
    odr_hz: Positive | None = None
    bandwidth_hz: Positive | None = None
    gyro_full_scale_dps: Positive | None = None


class _Board(msgspec.Struct, frozen=True):
    id: str
    port: str = ""
    bus: str = ""
    baud: Annotated[int, msgspec.Meta(ge=300)] = 115200
    format: str = "gcb1"
    facts: _Facts = _Facts()


class _Bus(msgspec.Struct, frozen=True):
    id: str
    port: str


class _Emulator(msgspec.Struct, frozen=True):
    dialect: Literal["d46", "e46", "d48e"] = "e46"
    command_time_ms: Annotated[float, msgspec.Meta(ge=0.0)] = 10.0
    odr_hz: Positive = 100.0
    bandwidth_hz: Positive | None = None
    gyro_full_scale_dps: Positive = 250.0


class _Site(msgspec.Struct, frozen=True):
    latitude_deg: float | None = None
    heading_deg: float | None = None
    gravity_m_s2: Positive | None = None


class _Rig(msgspec.Struct, frozen=True):
    schema: Literal["gyrorig/rig/1"]
    rig: str
    ptu: _Unit
    boards: Annotated[tuple[_Board, ...], msgspec.Meta(min_length=1)]
    buses: tuple[_Bus, ...] = ()
    site: _Site = _Site()
    emulator: _Emulator = _Emulator()


@dataclass(frozen=True, slots=True)
class RigModel:
    """The rig as a prediction needs it; the first board represents all boards."""

    name: str
    unit: UnitModel
    limits: RigLimits
    sensor_name: str
    odr_hz: float | None
    bandwidth_hz: float | None
    full_scale_dps: float | None
    timestamp_std_s: float
    site: Site
    is_unit_known: bool = True  # False: `unit` has the steps and times of a PTU-E46 instead

    def sensor(self, profile: SensorProfile) -> SensorModel:
        """Return the sensor model of a data sheet on this rig.

        Raises:
            UsageError: the data sheet lacks the noise or the full scale of the rig file.
        """
        return build_sensor_model(
            profile, self.odr_hz, self.bandwidth_hz, self.full_scale_dps, self.timestamp_std_s
        )


def load_rig(path: Path) -> RigModel:
    """Read the rig model from a rig file.

    Raises:
        UsageError: the file cannot be read, is not a rig file, allows no motion, or has no unit.
    """
    try:
        text = path.read_bytes()
    except OSError as fault:
        raise UsageError(
            f"the rig file {path} cannot be read ({fault.strerror})",
            "give a rig file, such as config/rig.yaml, with --rig",
        ) from fault
    document = convert_document(parse_yaml(text, path.name, schema=SCHEMA), _Rig, path.name)
    unit, board, emulator = document.ptu, document.boards[0], document.emulator
    if unit.driver == MANUAL:
        raise UsageError(
            f"in {path.name}, a person turns the boards (`driver: manual`), and this command needs "
            "the motion of a pan-tilt unit",
            "use the motion program config/manual/turns.yaml as it is, or give the rig file of a "
            "pan-tilt unit",
        )
    emulated = unit.port == EMULATED
    dialect: str = emulator.dialect if emulated else unit.dialect
    is_unit_known = unit.driver == KNOWN_DRIVER and dialect != UNKNOWN_DIALECT
    model = build_unit_model(
        Dialect.D46 if dialect == "d46" else Dialect.E46,
        unit.baud,
        emulator.command_time_ms * 1e-3 if emulated else None,
        unit.poll.rate_hz,
    )
    model = replace(
        model, pan=model.pan.with_sign(unit.pan_sign), tilt=model.tilt.with_sign(unit.tilt_sign)
    )
    facts = board.facts
    simulated = _port(document, board) == EMULATED
    return RigModel(
        name=document.rig,
        unit=apply_limits(model, unit.limits, path.name),
        limits=unit.limits,
        sensor_name=DEFAULT_SENSOR if simulated else facts.sensor or DEFAULT_SENSOR,
        odr_hz=emulator.odr_hz if simulated else facts.odr_hz,
        bandwidth_hz=emulator.bandwidth_hz if simulated else facts.bandwidth_hz,
        full_scale_dps=emulator.gyro_full_scale_dps if simulated else facts.gyro_full_scale_dps,
        timestamp_std_s=_timestamp_std_s(board, f"{path.name}: board {board.id}"),
        site=Site(
            document.site.latitude_deg,
            document.site.heading_deg,
            document.site.gravity_m_s2 or STANDARD_GRAVITY_M_S2,
        ),
        is_unit_known=is_unit_known,
    )


def _port(document: _Rig, board: _Board) -> str:
    """Return the port of a board, or of its bus."""
    buses = {bus.id: bus.port for bus in document.buses}
    return board.port or buses.get(board.bus, "")


def _timestamp_std_s(board: _Board, owner: str) -> float:
    """Return the common uncertainty of a board's times that its link causes."""
    if board.bus:
        return 0.0  # the edge of a frame is one event for both
    protocol = find_protocol(board.format, owner=owner)
    return _ping_latency_std_s(board.baud) if protocol.answers_time_requests else 0.0


def _ping_latency_std_s(baud: int) -> float:
    """Return the uncertainty of the link latency after pings: the wire time of one exchange."""
    request, reply = TimeRequest(0, 0).encode(), TimeReply(0, 0, 0, 0).encode()
    return (len(request) + len(reply)) * BITS_PER_BYTE / baud / float(np.sqrt(12.0))


def apply_limits(unit: UnitModel, limits: RigLimits, name: str) -> UnitModel:
    """Return a unit model within the limits of a rig.

    Raises:
        UsageError: the limits allow no motion; `name` is the file with the limits.
    """

    def axis(
        model: AxisModel, low_deg: float | None, high_deg: float | None, axis_name: str
    ) -> AxisModel:
        low = model.low_deg if low_deg is None else max(model.low_deg, low_deg)
        high = model.high_deg if high_deg is None else min(model.high_deg, high_deg)
        fastest = min(model.fastest_deg_s, limits.speed_deg_s or model.fastest_deg_s)
        if not low < high or fastest <= model.slowest_deg_s:
            raise UsageError(
                f"the limits of {axis_name} in {name} allow no motion ({low:g} to {high:g} deg, up "
                f"to {fastest:g} deg/s)",
                f"widen {axis_name}_min_deg, {axis_name}_max_deg or speed_deg_s under "
                "`ptu: limits`",
            )
        return replace(model, low_deg=low, high_deg=high, fastest_deg_s=fastest)

    return replace(
        unit,
        pan=axis(unit.pan, limits.pan_min_deg, limits.pan_max_deg, "pan"),
        tilt=axis(unit.tilt, limits.tilt_min_deg, limits.tilt_max_deg, "tilt"),
    )
