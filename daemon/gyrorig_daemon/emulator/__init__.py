"""Emulated rig: a pan-tilt unit and boards that behave like hardware, from one seed.

What to use when: `EmulatedRig` from `RigSettings`; `VirtualHub` for simulated time;
`pty_server.serve_rig` for other programs in real time. `EmulatedRig.truth` and `truth_document`
contain the true parameters. `causes` are the errors that a rig can have, `noise_free_rates` shows
their effect without noise, and `truth_commitment` keeps them secret until the end.
"""

from gyrorig_daemon.emulator.emulated_rig import PTU_PORT, EmulatedDevice, EmulatedRig, board_port
from gyrorig_daemon.emulator.emulator_settings import (
    BANDWIDTHS_HZ,
    BoardFaults,
    BoardSettings,
    PtuFaults,
    PtuSettings,
    RigSettings,
)
from gyrorig_daemon.emulator.rig_truth import RigTruth, sample_rig_truth
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
    "sample_rig_truth",
]
