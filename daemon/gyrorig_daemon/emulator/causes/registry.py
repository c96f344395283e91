"""Every cause by its id in the contract's catalogue."""

from collections.abc import Mapping
from types import MappingProxyType

from gyrorig_daemon.emulator.causes import bias, clock, link, sensor, unit, world
from gyrorig_daemon.emulator.causes.cause import Cause

CAUSES: Mapping[str, Cause] = MappingProxyType(
    {
        cause.name: cause
        for part in (clock, link, sensor, bias, unit, world)
        for cause in part.CAUSES
    }
)
