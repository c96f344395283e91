"""Online clock map: from the clock of a device to the capture clock, for display and alarms.

Recordings keep the raw timestamps. This map gives `publish_time` and /diagnostics; the solver
computes a better map offline. Use `OnlineClock`. Its parts are `CounterUnwrapper` (counter
wraps and resets) and `LatencyFloorFilter` (offset and skew). `capture_clock` has the clock of a
recording.
"""

from gyrorig_daemon.clocks.counter_unwrap import CounterUnwrapper
from gyrorig_daemon.clocks.latency_floor import LatencyFloorFilter, LatencyFloorState
from gyrorig_daemon.clocks.online_clock import ClockReport, OnlineClock

__all__ = [
    "ClockReport",
    "CounterUnwrapper",
    "LatencyFloorFilter",
    "LatencyFloorState",
    "OnlineClock",
]
