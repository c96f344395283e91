"""The rig's document, `gyrorig/rig/1`: which devices hang on which ports, and how.

What to use when: `load_rig` for a file that a person wrote. A port that reads
`emulated` stands for a device of the emulated rig; every other port is a path. So only
the ports differ between a rig on the desk and one that exists as a program. CAN buses, and
boards on them, are in `buses`.
"""

from pathlib import Path
from typing import Annotated, Literal, get_args

import msgspec

from gyrorig_daemon.config.buses import BusPort, Node, bus_port, check_buses
from gyrorig_daemon.config.names import first_twice
from gyrorig_daemon.config.service import ScheduleEntry, ServiceSettings, check_schedule
from gyrorig_protocol.board import ColumnMap, Sample
from gyrorig_protocol.can import SignalMap
from gyrorig_protocol.documents import parse_yaml, read_as
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId

SCHEMA = "gyrorig/rig/1"
EMULATED = "emulated"
PTU_PORT = "ptu"  # the hub's name of the unit's port; boards have "board:<id>"

BITS_PER_BYTE = 10  # 8N1
LINE_RESERVE = 1.2  # rates are up to 8 % above nominal, and answers need room too

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Sign = Literal[-1, 1]
Baud = Literal[
    600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 250000, 460800, 500000,
    921600, 1000000, 2000000,
]  # fmt: skip
PortPath = Annotated[str, msgspec.Meta(max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")]
Latitude = Annotated[float, msgspec.Meta(ge=-90.0, le=90.0)]
Heading = Annotated[float, msgspec.Meta(ge=-360.0, le=360.0)]


class Site(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where the rig stands; what is unknown is left out."""

    latitude_deg: Latitude | None = None
    heading_deg: Heading | None = None
    gravity_m_s2: Annotated[float, msgspec.Meta(ge=9.7, le=9.9)] | None = None


class CommandLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits tighter than the unit's own: what the cables and the room allow."""

    pan_min_deg: float | None = None
    pan_max_deg: float | None = None
    tilt_min_deg: float | None = None
    tilt_max_deg: float | None = None
    speed_deg_s: Positive | None = None


class Polling(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How fast positions are asked for, and how long an answer may take.

    The vendor's limit is 100 commands a second for E controllers and 10 for D ones
    (reference: vendor support FAQ on command rate); left out, that limit is used.
    """

    rate_hz: Annotated[float, msgspec.Meta(gt=0.0, le=500.0)] | None = None
    timeout_s: Annotated[float, msgspec.Meta(ge=0.05, le=30.0)] = 1.0


class PtuPort(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The pan-tilt unit: its port, its language and the signs of its axes."""

    port: PortPath
    baud: Baud = 9600
    dialect: Literal["auto", "d46", "e46"] = "auto"
    serial: Annotated[str, msgspec.Meta(min_length=1, max_length=64)] | None = None  # no other
    pan_sign: Sign = 1
    tilt_sign: Sign = 1
    limits: CommandLimits = CommandLimits()
    poll: Polling = Polling()
    home_without_asking: bool = False


class BoardFacts(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a board that has no HELLO cannot say itself; unknown values are left out."""

    uid: str | None = None
    model: str | None = None
    sensor: str | None = None
    firmware: str | None = None
    odr_hz: Positive | None = None
    bandwidth_hz: Positive | None = None
    gyro_full_scale_dps: Positive | None = None
    gyro_scale_rad_s: Positive | None = None
    accel_scale_m_s2: Positive | None = None
    temperature_scale_c: float | None = None
    temperature_offset_c: float | None = None
    tick_hz: Positive | None = None
    counter_bits: Annotated[int, msgspec.Meta(ge=8, le=64)] | None = None


class BoardPort(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One board: its name, its port or its bus, what its bytes are."""

    id: str
    port: PortPath = ""
    baud: Baud = 115200
    bus: Annotated[str, msgspec.Meta(max_length=32)] = ""  # of `buses`; then `port` is left out
    node: Node | None = None  # on that bus
    format: Literal["gcb1", "text", "signals"] = "gcb1"
    columns: ColumnMap | None = None  # of the text lines
    signals: SignalMap | None = None  # of the bus's frames
    facts: BoardFacts = BoardFacts()

    @property
    def board_id(self) -> BoardId:
        """The board's name, checked when the document was read."""
        return BoardId(self.id)

    @property
    def hub_port(self) -> str:
        """The name of this board's port in the hub: its own, or its bus's."""
        return bus_port(self.bus) if self.bus else f"board:{self.id}"


class Emulator(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The emulated rig, for ports that read `emulated`."""

    seed: Annotated[int, msgspec.Meta(ge=0)] = 1
    dialect: Literal["d46", "e46"] = "e46"
    command_time_ms: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)] = 10.0
    homed: bool = True
    odr_hz: Literal[100, 200, 400, 800] = 100
    bandwidth_hz: Positive | None = None
    gyro_full_scale_dps: Literal[250, 500, 2000] = 250


class RigConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A whole rig."""

    rig: str
    ptu: PtuPort
    boards: Annotated[tuple[BoardPort, ...], msgspec.Meta(min_length=1, max_length=64)]
    buses: Annotated[tuple[BusPort, ...], msgspec.Meta(max_length=8)] = ()
    schema: Literal["gyrorig/rig/1"] = "gyrorig/rig/1"
    site: Site = Site()
    emulator: Emulator = Emulator()
    schedule: Annotated[tuple[ScheduleEntry, ...], msgspec.Meta(max_length=100)] = ()
    service: ServiceSettings = ServiceSettings()

    @property
    def is_emulated(self) -> bool:
        """True when every port is an emulated one."""
        return all(port == EMULATED for port in self.ports().values())

    def ports(self) -> dict[str, str]:
        """Return the paths of all ports by the hub's names for them."""
        return {
            PTU_PORT: self.ptu.port,
            **{board.hub_port: board.port for board in self.serial_boards},
            **{bus.hub_port: bus.port for bus in self.buses},
        }

    @property
    def serial_boards(self) -> tuple[BoardPort, ...]:
        """The boards that have a port of their own."""
        return tuple(board for board in self.boards if not board.bus)

    def bus_boards(self, bus: BusPort) -> tuple[BoardPort, ...]:
        """Return the boards on a bus."""
        return tuple(board for board in self.boards if board.bus == bus.id)

    def is_emulated_board(self, board: BoardPort) -> bool:
        """Return whether a board's port or bus is an emulated one."""
        return self.ports()[board.hub_port] == EMULATED


def parse_rig(text: str | bytes, name: str, folder: Path | None = None) -> RigConfig:
    """Return the rig that a YAML document describes.

    Args:
        text: the document.
        name: what to call it in an error.
        folder: where DBC files that it names are; without it they are left unread.

    Raises:
        UsageError: the document is not a rig; the text says where and why.
    """
    rig = read_as(parse_yaml(text, name), RigConfig, name)
    if folder is not None:
        boards = tuple(_with_dbc(board, folder) for board in rig.boards)
        rig = msgspec.structs.replace(rig, boards=boards)
    try:
        BoardId(rig.rig)
        names = [BoardId(board.id) for board in rig.boards]
    except InputError as fault:
        raise UsageError(f"{name}: {fault.what}", fault.remedy) from fault
    if (again := first_twice(names)) is not None:
        raise UsageError(f"{name} names board {again} twice", "give each board its own id")
    paths = [path for path in rig.ports().values() if path != EMULATED]
    if (again := first_twice(paths)) is not None:
        raise UsageError(f"{name} names port {again} twice", "give each device its own port")
    check_buses(rig, name)
    for board in rig.serial_boards:
        _check_board(board, name)
        if board.port == EMULATED:
            _check_emulated_line(board, rig.emulator.odr_hz, name)
    _check_limits(rig.ptu.limits, name)
    check_schedule(rig.schedule, name)
    return rig


def load_rig(path: Path) -> RigConfig:
    """Return the rig that the file describes, with the DBC files that it names.

    Raises:
        UsageError: the file, or a DBC file, cannot be read or is not one.
    """
    return parse_rig(read_document(path), path.name, path.parent)


def _with_dbc(board: BoardPort, folder: Path) -> BoardPort:
    """Return a board whose DBC file, beside the rig's document, has been read."""
    if board.signals is None or board.signals.dbc_file is None:
        return board
    try:
        content = read_document(folder / board.signals.dbc_file)
    except UsageError as fault:
        raise UsageError(
            f"board {board.id}: its DBC file {fault.what}",
            "put it beside the rig's file, under the name that signals: dbc gives",
        ) from fault
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:  # Windows tools write their own letters, a degree sign at most
        text = content.decode("cp1252", errors="replace")
    signals = msgspec.structs.replace(board.signals, dbc=text + "\n")
    return msgspec.structs.replace(board, signals=signals)


def read_document(path: Path) -> bytes:
    """Return the bytes of a configuration or program file.

    Raises:
        UsageError: there is no such file, or it cannot be read.
    """
    try:
        text = path.read_bytes()
    except OSError as fault:
        raise UsageError(
            f"{path} cannot be read, {fault.strerror}", "name a file, such as those in config/"
        ) from fault
    if not text.strip():
        raise UsageError(f"{path} is empty", "see config/ for examples")
    return text


def _check_board(board: BoardPort, name: str) -> None:
    if not board.port or board.format == "signals":
        raise UsageError(f"{name}: board {board.id} has no port", "give its port, or bus and node")
    if board.format == "gcb1":
        if board.columns is not None:
            raise UsageError(
                f"{name}: board {board.id} has columns, and its format is gcb1, which has none",
                "give it format: text, or leave out columns",
            )
        return
    if board.port == EMULATED:
        raise UsageError(
            f"{name}: board {board.id} is emulated, and such a board sends gcb1",
            "leave out its format: text",
        )
    if board.columns is None:
        raise UsageError(
            f"{name}: board {board.id} sends text and nothing says which column is what",
            "give it columns, as config/rig-raspberrypi.yaml shows",
        )
    scale = board.facts.gyro_scale_rad_s or board.columns.gyro_scale_rad_s
    if not (board.facts.uid and board.facts.sensor and scale):
        raise UsageError(
            f"{name}: board {board.id} sends text and cannot say what it is",
            "give facts: uid, sensor and, for counts, gyro_scale_rad_s",
        )


def _check_emulated_line(board: BoardPort, odr_hz: int, name: str) -> None:
    """Refuse a line that cannot carry the samples: they would come later and later."""
    frame = Sample(0, 0, 0, (0, 0, 0), (0, 0, 0), 0).encode()
    needed = len(frame) * BITS_PER_BYTE * odr_hz * LINE_RESERVE
    if board.baud < needed:
        enough = min(baud for baud in get_args(Baud) if baud >= needed)
        raise UsageError(
            f"{name}: board {board.id} cannot send {odr_hz} samples a second at {board.baud} baud",
            f"give it a baud of {enough} or more",
        )


def _check_limits(limits: CommandLimits, name: str) -> None:
    for axis, low, high in (
        ("pan", limits.pan_min_deg, limits.pan_max_deg),
        ("tilt", limits.tilt_min_deg, limits.tilt_max_deg),
    ):
        if low is not None and high is not None and low >= high:
            raise UsageError(
                f"{name}: limits: {axis}_min_deg {low:g} is not below {axis}_max_deg {high:g}",
                "give the lesser angle as the minimum, whatever the signs",
            )
