"""The rig's configuration as a person writes it."""

from gyrorig_daemon.config.buses import BusPort
from gyrorig_daemon.config.document import (
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
