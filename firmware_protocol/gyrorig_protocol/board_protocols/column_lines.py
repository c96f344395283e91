"""Lines of numbers on a serial port; `columns` in the rig file says what they are."""

from collections.abc import Mapping
from types import MappingProxyType

from gyrorig_protocol.board import TextLineParser
from gyrorig_protocol.board_protocols.board_protocol import BoardEntry, SerialProtocol
from gyrorig_protocol.errors import UsageError

REMEDY = "add the key `columns`, as in config/rig-raspberrypi.yaml"


class TextLines(SerialProtocol):
    """One line per sample, separated by commas, spaces or tabs."""

    name = "text"
    description = "lines of numbers"
    sample_bytes = 64
    required_keys = MappingProxyType({"columns": REMEDY})

    def make_parser(self, board: BoardEntry) -> TextLineParser:
        """Return a parser of the lines."""
        if board.columns is None:
            raise UsageError(
                f"board {board.id} has `format: text`, but not the key `columns`",
                REMEDY,
            )
        return TextLineParser(board.columns)

    def scales(self, board: BoardEntry) -> Mapping[str, str | float | int | None]:
        """Return the scales of columns in physical units."""
        columns = board.columns
        if columns is None:
            return {}
        return {
            "gyro_scale_rad_s": columns.gyro_scale_rad_s,
            "accel_scale_m_s2": columns.accel_scale_m_s2,
            "temperature_scale_c": columns.temperature_scale_c,
            "tick_hz": columns.tick_hz,
        }


PROTOCOL = TextLines()
