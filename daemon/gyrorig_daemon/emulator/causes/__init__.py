"""What an emulated rig can hide: the causes of the results contract's catalogue.

What to use when: `parse_hide` for what a person asks for, `draw_hidden` for the causes with
their parameters, `hang` to put them on a rig's hooks; `CAUSES` for names, units and sizes.
"""

from gyrorig_daemon.emulator.causes.cause import Cause, Hidden, Quantity
from gyrorig_daemon.emulator.causes.draw import draw_hidden, hang
from gyrorig_daemon.emulator.causes.order import RANDOM, parse_hide
from gyrorig_daemon.emulator.causes.registry import CAUSES

__all__ = ["CAUSES", "RANDOM", "Cause", "Hidden", "Quantity", "draw_hidden", "hang", "parse_hide"]
