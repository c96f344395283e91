"""The emulated rig: a unit and boards that behave like hardware, from one seed.

What to use when: `EmulatedRig` from `RigSettings`; `VirtualHub` over it where time is
simulated; `serve` where other programs talk to it through ptys. The truth behind the ports
is `EmulatedRig.truth` and `truth_document`. `causes` holds what a rig can hide, `noise_free`
and `noncentrality` how visible that is, `sealed` keeps it secret until the end.
"""

from gyrorig_daemon.emulator.device import EmulatedDevice
from gyrorig_daemon.emulator.rig import PTU_PORT, EmulatedRig, board_port
from gyrorig_daemon.emulator.settings import (
    BANDWIDTHS_HZ,
    BoardFaults,
    BoardSettings,
    PtuFaults,
    PtuSettings,
    RigSettings,
)
from gyrorig_daemon.emulator.truth import RigTruth, draw_rig_truth
from gyrorig_daemon.emulator.virtual_hub import VirtualHub

__all__ = [
    "BANDWIDTHS_HZ",
    "PTU_PORT",
    "BoardFaults",
    "BoardSettings",
    "EmulatedDevice",
    "EmulatedRig",
    "PtuFaults",
    "PtuSettings",
    "RigSettings",
    "RigTruth",
    "VirtualHub",
    "board_port",
    "draw_rig_truth",
]
