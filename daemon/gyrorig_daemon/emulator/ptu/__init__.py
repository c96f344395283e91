"""Emulated pan-tilt unit: a separate interpreter, independent of the protocol package's parser.

What to use when: `EmulatedPtu` as a device on a line; `PtuSettings` (in `emulator_settings`) for
its properties. `axis_commands` and `unit_commands` implement the commands.
"""

from gyrorig_daemon.emulator.ptu.emulated_unit import EmulatedPtu

__all__ = ["EmulatedPtu"]
