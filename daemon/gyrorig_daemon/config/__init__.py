"""Configuration of a rig: the document `gyrorig/rig/1` and its parts.

What to use when: `load_rig` for a file, `parse_rig` for text, `RigConfig` for the result.
"""

from gyrorig_daemon.config.bus_config import BusPort
from gyrorig_daemon.config.rig_document import (
    EMULATED,
    PTU_PORT,
    BoardFacts,
    BoardPort,
    CommandLimits,
    Emulator,
    Polling,
    PtuPort,
    RigConfig,
    Site,
    load_rig,
    parse_rig,
    read_document,
)

__all__ = [
    "EMULATED",
    "PTU_PORT",
    "BoardFacts",
    "BoardPort",
    "BusPort",
    "CommandLimits",
    "Emulator",
    "Polling",
    "PtuPort",
    "RigConfig",
    "Site",
    "load_rig",
    "parse_rig",
    "read_document",
]
