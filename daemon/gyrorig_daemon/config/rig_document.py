"""The rig document, `gyrorig/rig/1`: devices, ports and their settings.

What to use when: `load_rig` for a file that a person wrote. A port with the value `emulated` is a
device of the emulated rig; every other port is a path. Therefore a real rig and an emulated one
differ only in their ports. `bus_config` defines CAN buses and the boards on them.
"""

import contextlib
from pathlib import Path
from typing import Annotated, Literal, get_args

import msgspec

from gyrorig_daemon.config.board_settings import validate_protocol
from gyrorig_daemon.config.bus_config import (
    BusPort,
    Node,
    bus_port,
    first_duplicate,
    validate_buses,
)
from gyrorig_daemon.config.service_settings import ScheduleEntry, ServiceSettings, validate_schedule
from gyrorig_protocol.board import ColumnMap
from gyrorig_protocol.board_protocols import SerialProtocol
from gyrorig_protocol.can import SignalMap
from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.suggestions import did_you_mean
from gyrorig_protocol.twin import Twin, check_twin

SCHEMA = "gyrorig/rig/1"
EMULATED = "emulated"
MANUAL = "manual"  # the driver of a person
TERMINAL = "terminal"  # the port of a person who reads the terminal
PTU_PORT = "ptu"  # the hub's name of the unit's port; boards have "board:<id>"

BITS_PER_BYTE = 10  # 8N1
LINE_MARGIN = 1.2  # sample rates are up to 8 % above nominal, and replies need capacity too

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Sign = Literal[-1, 1]
Baud = Literal[
    600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 250000, 460800, 500000,
    921600, 1000000, 2000000,
]  # fmt: skip
PortPath = Annotated[str, msgspec.Meta(max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")]
UnitWord = Annotated[str, msgspec.Meta(max_length=200, pattern=r"^[\x20-\x7e]*$")]
DriverName = Annotated[str, msgspec.Meta(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
Latitude = Annotated[float, msgspec.Meta(ge=-90.0, le=90.0)]
Heading = Annotated[float, msgspec.Meta(ge=-360.0, le=360.0)]


class Site(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Location of the rig; unknown values are omitted."""

    latitude_deg: Latitude | None = None
    heading_deg: Heading | None = None
    gravity_m_s2: Annotated[float, msgspec.Meta(ge=9.7, le=9.9)] | None = None


class CommandLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits tighter than the unit's own, for cables and walls."""

    pan_min_deg: float | None = None
    pan_max_deg: float | None = None
    tilt_min_deg: float | None = None
    tilt_max_deg: float | None = None
    speed_deg_s: Annotated[float, msgspec.Meta(gt=0.0, le=1e6)] | None = None


class Polling(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Rate of position requests, and time limit of a reply.

    The vendor's limit is 100 commands per second for E controllers and 10 for D controllers
    (FLIR support FAQ on the command rate). By default that limit is used.
    """

    rate_hz: Annotated[float, msgspec.Meta(gt=0.0, le=500.0)] | None = None
    timeout_s: Annotated[float, msgspec.Meta(ge=0.05, le=30.0)] = 1.0


class PtuPort(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The pan-tilt unit: its port, its driver, its dialect and the signs of its axes."""

    port: PortPath
    driver: DriverName = "directed_perception"
    baud: Baud = 9600
    dialect: Literal["auto", "d46", "e46"] = "auto"
    serial: Annotated[str, msgspec.Meta(min_length=1, max_length=64)] | None = None  # no other
    commands: dict[UnitWord, UnitWord] = {}  # replace those of a driver of text lines
    pan_sign: Sign = 1
    tilt_sign: Sign = 1
    limits: CommandLimits = CommandLimits()
    poll: Polling = Polling()
    home_without_asking: bool = False

    @property
    def is_person(self) -> bool:
        """Whether a person turns the board, instead of a unit."""
        return self.driver == MANUAL


class BoardFacts(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Properties of a board without HELLO; unknown values are omitted."""

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
    """One board: its name, its port or bus, and its data format."""

    id: str
    port: PortPath = ""
    baud: Baud = 115200
    bus: Annotated[str, msgspec.Meta(max_length=32)] = (
        ""  # an id of `buses`; then there is no `port`
    )
    node: Node | None = None  # on that bus
    format: Annotated[str, msgspec.Meta(max_length=32)] = "gcb1"  # see `board_protocols`
    columns: ColumnMap | None = None  # of the text lines
    signals: SignalMap | None = None  # of the bus's frames
    options: Annotated[dict[str, str | int | float | bool], msgspec.Meta(max_length=32)] = (
        msgspec.field(default_factory=dict)
    )  # of other protocols
    facts: BoardFacts = BoardFacts()

    @property
    def board_id(self) -> BoardId:
        """The board's name, validated when the document was read."""
        return BoardId(self.id)

    @property
    def hub_port(self) -> str:
        """Name of this board's port in the hub: its own, or that of its bus."""
        return bus_port(self.bus) if self.bus else f"board:{self.id}"


class Emulator(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The emulated rig, for ports with the value `emulated`."""

    seed: Annotated[int, msgspec.Meta(ge=0)] = 1
    dialect: Literal["d46", "e46", "d48e"] = "e46"
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
    twin: Twin | None = None  # measured properties of a rig, for its emulated devices

    @property
    def is_emulated(self) -> bool:
        """True when every port is an emulated one."""
        return all(port == EMULATED for port in self.ports().values())

    def ports(self) -> dict[str, str]:
        """Return the paths of all ports by their names in the hub."""
        unit = {} if self.ptu.is_person and self.ptu.port == TERMINAL else {PTU_PORT: self.ptu.port}
        return {
            **unit,
            **{board.hub_port: board.port for board in self.serial_boards},
            **{bus.hub_port: bus.port for bus in self.buses},
        }

    @property
    def serial_boards(self) -> tuple[BoardPort, ...]:
        """The boards that are connected to a port, not to a bus."""
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
        name: name of the document in error messages.
        folder: folder of the DBC files; without it they are not read.

    Raises:
        UsageError: the document is invalid; the text gives the place and the reason.
    """
    rig = convert_document(parse_yaml(text, name, schema=SCHEMA), RigConfig, name)
    if folder is not None:
        boards = tuple(_with_dbc_text(board, folder) for board in rig.boards)
        rig = msgspec.structs.replace(rig, boards=boards)
    try:
        BoardId(rig.rig)
    except InputError as error:
        raise UsageError(
            f"{name}: {rig.rig[:40]!r} is not a valid name of a rig", error.remedy
        ) from error
    try:
        names = [BoardId(board.id) for board in rig.boards]
    except InputError as error:
        raise UsageError(f"{name}: {error.problem}", error.remedy) from error
    if (duplicate := first_duplicate(names)) is not None:
        raise UsageError(
            f"{name} defines board {duplicate} twice", "give each board a different `id`"
        )
    paths = [path for path in rig.ports().values() if path != EMULATED]
    if (duplicate := first_duplicate(paths)) is not None:
        raise UsageError(
            f"{name} uses the port {duplicate} for two devices",
            "give each device a different `port`",
        )
    validate_buses(rig, name)
    for board in rig.serial_boards:
        _validate_board(board, rig.emulator.odr_hz, name)
    if rig.ptu.is_person and rig.ptu.port not in (TERMINAL, EMULATED):
        raise UsageError(
            f"{name}: a person has no port, but `port` under `ptu` is {rig.ptu.port!r:.60}",
            "write `port: terminal`, or `port: emulated` for an emulated person",
        )
    _validate_limits(rig.ptu.limits, name)
    validate_schedule(rig.schedule, name)
    if rig.twin is not None:
        _validate_twin(rig, rig.twin, name)
    return rig


def load_rig(path: Path) -> RigConfig:
    """Return the rig that a file describes, including its DBC files.

    Raises:
        UsageError: the file or a DBC file cannot be read, or is invalid.
    """
    return parse_rig(read_document(path), path.name, path.parent)


def _with_dbc_text(board: BoardPort, folder: Path) -> BoardPort:
    """Return a board with the text of its DBC file, which is relative to the rig's file."""
    if board.signals is None or board.signals.dbc_file is None:
        return board
    try:
        content = read_document(folder / board.signals.dbc_file)
    except UsageError as error:
        raise UsageError(
            f"the DBC file of board {board.id} cannot be used: {error.problem}",
            "copy the DBC file to the folder of the rig file, under the name that `signals: "
            "dbc` gives",
        ) from error
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:  # Windows tools write cp1252, for example a degree sign
        text = content.decode("cp1252", errors="replace")
    signals = msgspec.structs.replace(board.signals, dbc=text + "\n")
    return msgspec.structs.replace(board, signals=signals)


def read_document(path: Path, limit_bytes: int | None = None) -> bytes:
    """Return the bytes of a configuration or program file; of a longer one, one byte too many.

    Raises:
        UsageError: the file does not exist, cannot be read, or is empty.
    """
    try:
        with path.open("rb") as file:
            text = file.read(-1 if limit_bytes is None else limit_bytes + 1)
    except OSError as error:
        hint = did_you_mean(path.name, _sibling_names(path))
        raise UsageError(
            f"{path} cannot be read ({error.strerror})",
            hint or "give the path of an existing file; there are examples in the folder config/",
        ) from error
    if not text.strip():
        raise UsageError(
            f"the file {path} is empty",
            "give another file, or write this file like the examples in the folder config/",
        )
    return text


def _sibling_names(path: Path) -> list[str]:
    with contextlib.suppress(OSError):
        return [file.name for file in path.parent.iterdir()]
    return []


def _validate_board(board: BoardPort, odr_hz: int, name: str) -> None:
    if not board.port:
        raise UsageError(
            f"{name}: board {board.id} has neither a port nor a CAN bus",
            "add the key `port`, or the keys `bus` and `node`",
        )
    protocol = validate_protocol(board, name)
    if board.port == EMULATED and isinstance(protocol, SerialProtocol):
        _validate_emulated_line(board, protocol.sample_bytes, odr_hz, name)


def _validate_emulated_line(board: BoardPort, sample_bytes: int, odr_hz: int, name: str) -> None:
    """Reject a line without enough capacity, because samples would be later and later."""
    needed_baud = sample_bytes * BITS_PER_BYTE * odr_hz * LINE_MARGIN
    if board.baud < needed_baud:
        sufficient_baud = min(baud for baud in get_args(Baud) if baud >= needed_baud)
        raise UsageError(
            f"{name}: board {board.id} cannot send {odr_hz} samples per second at "
            f"{board.baud} baud",
            f"set `baud` to {sufficient_baud} or more",
        )


def _validate_twin(rig: RigConfig, twin: Twin, name: str) -> None:
    check_twin(twin, f"{name}: twin")
    for board in rig.boards:
        if rig.is_emulated_board(board) and board.id not in twin.boards:
            hint = did_you_mean(board.id, twin.boards)
            raise UsageError(
                f"{name}: the section `twin` has no board {board.id}",
                hint or f"give the board an id of the twin: {', '.join(twin.boards)}",
            )


def _validate_limits(limits: CommandLimits, name: str) -> None:
    for axis, low, high in (
        ("pan", limits.pan_min_deg, limits.pan_max_deg),
        ("tilt", limits.tilt_min_deg, limits.tilt_max_deg),
    ):
        if low is not None and high is not None and low >= high:
            raise UsageError(
                f"{name}: under `limits`, {axis}_min_deg ({low:g}) is not less than "
                f"{axis}_max_deg ({high:g})",
                "correct one of the two limits",
            )
