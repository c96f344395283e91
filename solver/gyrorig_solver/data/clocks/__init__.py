"""Offline clock maps: from the clock of a device to the capture clock.

What to use when: `map_clock` converts ticks and arrival times to sample times on the capture
clock, with their uncertainty; `unwrap_ticks` only makes raw counters continuous and finds
restarts and clock steps. `latency_floor` selects between the envelope (`lower_envelope`) and the
smoother (`clock_smoother`), `latency_bounds` uses pings, `sample_numbering` numbers the samples,
and `shared_time_base` puts the boards of a bus on one time. The method is in docs/clocks.md.
"""

from gyrorig_solver.data.clocks.clock_faults import ClockFault, ClockFaultKind
from gyrorig_solver.data.clocks.clock_map import ClockMap, map_clock
from gyrorig_solver.data.clocks.tick_unwrapping import UnwrappedTicks, unwrap_ticks

__all__ = [
    "ClockFault",
    "ClockFaultKind",
    "ClockMap",
    "UnwrappedTicks",
    "map_clock",
    "unwrap_ticks",
]
