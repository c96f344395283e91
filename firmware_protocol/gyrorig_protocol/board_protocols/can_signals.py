"""Frames of any IMU on a CAN bus, by a DBC file or a preset; `signals` in the rig file."""

from collections.abc import Mapping
from types import MappingProxyType

from gyrorig_protocol.board_protocols.board_protocol import BoardEntry, CanProtocol
from gyrorig_protocol.can import CanSignalParser, ResolvedSignalMap, resolve_signals
from gyrorig_protocol.errors import UsageError

REMEDY = "add the key `signals` with `preset`, or with `dbc` and `gyro`"


class CanSignals(CanProtocol):
    """An IMU that only sends; its frames are described by signals."""

    name = "signals"
    description = "CAN frames with signals"
    required_keys = MappingProxyType({"signals": REMEDY})

    def make_parser(self, board: BoardEntry) -> CanSignalParser:
        """Return a parser of the signals."""
        return CanSignalParser(_resolve(board))

    def scales(self, board: BoardEntry) -> Mapping[str, str | float | int | None]:
        """Return the scales of the signals."""
        signal_map = _resolve(board)
        timer = signal_map.time
        return {
            "sensor": board.facts.sensor or signal_map.sensor or None,
            "gyro_scale_rad_s": signal_map.gyro_scale_rad_s,
            "accel_scale_m_s2": signal_map.accel_scale_m_s2,
            "temperature_scale_c": signal_map.temperature_scale_c,
            "temperature_offset_c": None if signal_map.temperature is None else 0.0,
            "tick_hz": signal_map.tick_hz,
            "counter_bits": None if timer is None else timer.signal.bit_length,
        }

    def check_settings(self, board: BoardEntry, name: str) -> None:
        """Check signals and identity; see `BoardProtocol.check_settings`."""
        signals, facts = board.signals, board.facts
        if signals is None:
            return
        if not facts.uid or not (facts.sensor or signals.preset):
            missing = "sensor" if facts.uid else "uid"
            raise UsageError(
                f"{name}: a board with `format: signals` does not identify itself, but board "
                f"{board.id} has no `{missing}` under `facts`",
                "add the type of the sensor as `sensor` under `facts`"
                if facts.uid
                else "choose a name that no other board has, and add it as `uid` under `facts`",
            )
        if signals.dbc_file is None:
            resolve_signals(signals, board.id)


def _resolve(board: BoardEntry) -> ResolvedSignalMap:
    if board.signals is None:
        raise UsageError(
            f"board {board.id} has `format: signals`, but not the key `signals`",
            REMEDY,
        )
    return resolve_signals(board.signals, board.id)


PROTOCOL = CanSignals()
