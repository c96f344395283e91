"""The emulated pan-tilt unit: its own interpreter, apart from the protocol package's parser.

What to use when: `EmulatedPtu` as a device on a line; `PtuSettings` (in `settings`) for what
it is. `language` and `unit_commands` hold what each command does.
"""

from gyrorig_daemon.emulator.ptu.device import EmulatedPtu

__all__ = ["EmulatedPtu"]
