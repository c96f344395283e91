"""The ordinary part of a twin's rig file: the devices, all of them emulated.

A recording of `gyrorigd` contains the rig file of its session. The twin takes the boards, their
formats and the settings of the unit from it. An imported recording has no rig file; then each board
sends frames of this project.

What to use when: `build_rig_mapping`; the caller then adds the section `twin`.
"""

import math
from collections.abc import Mapping
from typing import Any

from gyrorig_protocol.board_protocols import SerialProtocol, find_protocol
from gyrorig_protocol.documents import parse_yaml
from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.twin import Twin, TwinBoard

SCHEMA = "gyrorig/rig/1"
RIG_ATTACHMENT = "rig.yaml"
EMULATED = "emulated"
BITS_PER_BYTE = 10  # 8N1
LINE_MARGIN = 1.2  # sample rates are up to 8 % above nominal, and replies need capacity too
SLOW_BAUDS = (600, 1200, 2400, 4800, 9600, 19200, 38400, 57600)  # of a unit
BAUDS = (115200, 230400, 250000, 460800, 500000, 921600, 1000000, 2000000)
NOMINAL_ODRS_HZ = (100, 200, 400, 800)  # of the emulated sensor
FULL_SCALES_DPS = (250, 500, 2000)
DIALECTS = ("d46", "e46", "d48e")
UNIT_KEYS = ("driver", "baud", "dialect", "commands", "pan_sign", "tilt_sign", "limits", "poll")


def recorded_rig(recording: Recording) -> dict[str, Any]:
    """Return the rig file of the session, an empty mapping without a usable one."""
    text = next((a.data for a in recording.attachments if a.name == RIG_ATTACHMENT), b"")
    try:
        value = parse_yaml(text, RIG_ATTACHMENT) if text else {}
    except GyrorigError:
        return {}
    return value if isinstance(value, dict) and value.get("schema") == SCHEMA else {}


def board_line(recording: Recording, board: str) -> tuple[str, float | None]:
    """Return the format of a board and the baud rate of its line, None if it has none."""
    entry = _entries(recorded_rig(recording), "boards").get(board, {})
    baud = entry.get("baud", 115200)
    is_on_line = bool(entry) and not entry.get("bus") and isinstance(baud, int)
    return str(entry.get("format", "gcb1")), float(baud) if is_on_line else None


def build_rig_mapping(recording: Recording, twin: Twin) -> dict[str, Any]:
    """Return the rig file without the section `twin`, for `dump_yaml`."""
    rig = recorded_rig(recording)
    entries = _entries(rig, "boards")
    fastest = max(twin.boards.values(), key=_odr_hz)
    nominal_hz = _nominal_odr_hz(fastest)
    boards = [
        _board(entries.get(name, {}), name, max(_odr_hz(board), nominal_hz), recording)
        for name, board in twin.boards.items()
    ]
    buses = [
        {**bus, "port": EMULATED}
        for name, bus in _entries(rig, "buses").items()
        if any(board.get("bus") == name for board in boards)
    ]
    mapping: dict[str, Any] = {
        "schema": SCHEMA,
        "rig": rig.get("rig") if isinstance(rig.get("rig"), str) else "twin",
    }
    site = _site(recording)
    if site:
        mapping["site"] = site
    mapping["ptu"] = _unit(rig, recording)
    if buses:
        mapping["buses"] = buses
    mapping["boards"] = boards
    mapping["emulator"] = _emulator(rig, recording, twin, fastest)
    return mapping


def _entries(rig: Mapping[str, Any], key: str) -> dict[str, dict[str, Any]]:
    """Return the mappings of a list by their ids."""
    values = rig.get(key)
    items = values if isinstance(values, list) else []
    return {str(v["id"]): dict(v) for v in items if isinstance(v, dict) and "id" in v}


def _board(
    entry: Mapping[str, Any], name: str, odr_hz: float, recording: Recording
) -> dict[str, Any]:
    """Return the entry of a board, with a line that is fast enough for its samples."""
    if entry.get("bus"):
        return _with_dbc_text(entry, recording)
    values = {**(entry or {"id": name}), "port": EMULATED}
    try:
        protocol = find_protocol(str(values.get("format", "gcb1")))
    except GyrorigError:
        values = {"id": name, "port": EMULATED}
        protocol = find_protocol("gcb1")
    if isinstance(protocol, SerialProtocol):
        needed = protocol.sample_bytes * BITS_PER_BYTE * LINE_MARGIN * odr_hz
        baud = values.get("baud", 115200)
        if not isinstance(baud, int) or baud < needed:
            values["baud"] = next((b for b in BAUDS if b >= needed), BAUDS[-1])
    return values


def _with_dbc_text(entry: Mapping[str, Any], recording: Recording) -> dict[str, Any]:
    """Return a board with the text of its DBC file, which the recording contains."""
    name = f"signals.{entry['id']}.dbc"
    text = next((a.data for a in recording.attachments if a.name == name), None)
    signals = entry.get("signals")
    if text is None or not isinstance(signals, dict):
        return dict(entry)
    return {**entry, "signals": {**signals, "dbc": text.decode(errors="replace")}}


def _odr_hz(board: TwinBoard) -> float:
    return 100.0 if board.odr is None else board.odr.value


def _nominal_odr_hz(board: TwinBoard) -> int:
    """Return the rate of the emulated sensor that is nearest to that of a board."""
    odr_hz = _odr_hz(board)
    return min(NOMINAL_ODRS_HZ, key=lambda choice: abs(math.log(choice / odr_hz)))


def _unit(rig: Mapping[str, Any], recording: Recording) -> dict[str, Any]:
    """Return the entry of the unit, with the recorded baud rate if no rig file has it."""
    unit = rig.get("ptu")
    values = {k: v for k, v in unit.items() if k in UNIT_KEYS} if isinstance(unit, dict) else {}
    stated = recording.metadata.get("gyrorig.ptu", {}).get("baud", "")
    if "baud" not in values and stated in map(str, (*SLOW_BAUDS, *BAUDS)):
        values["baud"] = int(stated)
    return {"port": EMULATED, **values}


def _site(recording: Recording) -> dict[str, float]:
    site = {}
    for key in ("latitude_deg", "heading_deg", "gravity_m_s2"):
        text = recording.metadata.get("gyrorig.site", {}).get(key, "")
        try:
            value = float(text)
        except ValueError:
            continue
        if math.isfinite(value):
            site[key] = value
    return site


def _emulator(
    rig: Mapping[str, Any], recording: Recording, twin: Twin, board: TwinBoard
) -> dict[str, Any]:
    """Return the settings that all boards have in common; the section `twin` has the rest."""
    given = rig.get("emulator")
    dialect = given.get("dialect") if isinstance(given, dict) else None
    stated = recording.metadata.get("gyrorig.ptu", {}).get("dialect")
    emulator: dict[str, Any] = {
        "seed": 1,
        "dialect": next((d for d in (dialect, stated) if d in DIALECTS), "e46"),
        "odr_hz": _nominal_odr_hz(board),
    }
    unit = twin.unit
    if unit is not None and unit.answer_time is not None:
        emulator["command_time_ms"] = min(round(1e3 * unit.answer_time.value, 3), 1000.0)
    if board.bandwidth is not None:
        emulator["bandwidth_hz"] = board.bandwidth.value
    if board.full_scale is not None:
        dps = math.degrees(board.full_scale.value)
        emulator["gyro_full_scale_dps"] = next(
            (choice for choice in FULL_SCALES_DPS if choice >= dps * 0.99), FULL_SCALES_DPS[-1]
        )
    return emulator
