"""Emulated GY-80 board: a sensor, a clock and a firmware that sends frames or text lines.

What to use when: `EmulatedBoard` for a board on a serial line, `EmulatedCanBoard` for one on a CAN
bus; `BoardSettings` (in `emulator_settings`) for its properties.
"""

from gyrorig_daemon.emulator.board.emulated_board import EmulatedBoard
from gyrorig_daemon.emulator.board.emulated_can_board import EmulatedCanBoard

__all__ = ["EmulatedBoard", "EmulatedCanBoard"]
