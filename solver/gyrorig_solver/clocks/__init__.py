"""From a device's own clock to the capture clock, offline.

What to use when: `mapping.map_clock` to turn ticks and arrival times into sample times on
the capture clock, with what is known of their error; `unwrap.unwrap_ticks` alone to make
raw counters continuous and to find restarts and clock steps (`faults` judges them).
Below them, `floor` chooses between the lower envelopes in `envelope` and the smoother in
`smoother`; `pings` bounds the constant that arrivals cannot show; `simulated` has clocks
and links whose truth is known. The method and its figures: docs/clocks.md.
"""

from gyrorig_solver.clocks.faults import ClockFault, FaultKind
from gyrorig_solver.clocks.mapping import ClockMap, map_clock
from gyrorig_solver.clocks.unwrap import Unwrapped, unwrap_ticks

__all__ = ["ClockFault", "ClockMap", "FaultKind", "Unwrapped", "map_clock", "unwrap_ticks"]
