"""The emulated GY-80: a sensor, a clock and a firmware that speaks frames or text lines.

What to use when: `EmulatedBoard` as a device on a line, `EmulatedCanBoard` for one on a bus;
`BoardSettings` (in `settings`) for what it is.
"""

from gyrorig_daemon.emulator.board.can_device import EmulatedCanBoard
from gyrorig_daemon.emulator.board.device import EmulatedBoard

__all__ = ["EmulatedBoard", "EmulatedCanBoard"]
