"""The emulated GY-80: a sensor, a clock and a firmware that speaks frames or text lines.

What to use when: `EmulatedBoard` as a device on a line; `BoardSettings` (in `settings`) for
what it is.
"""

from gyrorig_daemon.emulator.board.device import EmulatedBoard

__all__ = ["EmulatedBoard"]
