"""From a device's own clock to the capture clock, offline.

What to use when: `unwrap.unwrap_ticks` to make raw counters continuous and to find
restarts; `mapping.map_clock` to turn ticks and arrival times into sample times on the
capture clock, with what is known of their error; `envelope` holds the two lower
envelopes that the mapping rests on.
"""

from gyrorig_solver.clocks.mapping import ClockMap, map_clock
from gyrorig_solver.clocks.unwrap import Unwrapped, unwrap_ticks

__all__ = ["ClockMap", "Unwrapped", "map_clock", "unwrap_ticks"]
