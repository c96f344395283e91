"""The online map from every device's clock to the capture clock, for display and alarms.

Raw stamps are what is recorded; this map gives `publish_time` and /diagnostics. The
solver maps again, better, offline. Use `OnlineClock`; the parts it is made of are
`Unwrapper` (counter bits and resets) and `FloorFilter` (offset and skew).
"""

from gyrorig_daemon.clocks.floor import FloorFilter, FloorState
from gyrorig_daemon.clocks.online import ClockReport, OnlineClock
from gyrorig_daemon.clocks.unwrap import Unwrapper

__all__ = ["ClockReport", "FloorFilter", "FloorState", "OnlineClock", "Unwrapper"]
