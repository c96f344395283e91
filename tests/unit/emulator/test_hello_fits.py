"""Every configuration of the emulated board has a HELLO that fits one frame."""

import pytest

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import BANDWIDTHS_HZ, BoardSettings, RigSettings
from gyrorig_daemon.emulator.rig_truth import GYRO_MDPS_PER_COUNT
from gyrorig_protocol.board import FrameEvent, FrameParser, Hello


@pytest.mark.parametrize("full_scale_dps", sorted(GYRO_MDPS_PER_COUNT))
@pytest.mark.parametrize(
    ("odr_hz", "bandwidth_hz"), [(o, b) for o, many in sorted(BANDWIDTHS_HZ.items()) for b in many]
)
def test_hello_fits(odr_hz: float, bandwidth_hz: float, full_scale_dps: float) -> None:
    settings = BoardSettings(
        name="GY80-" + "7" * 27,
        odr_hz=odr_hz,
        bandwidth_hz=bandwidth_hz,
        full_scale_dps=full_scale_dps,
    )
    rig = EmulatedRig(RigSettings(boards=(settings,)), 0)
    board = rig.boards[settings.name]
    sent = b"".join(data for _, data in board.take_output(100_000_000))
    events = [e for e in FrameParser().feed(sent, 0) if isinstance(e, FrameEvent)]
    hello = next(e.frame for e in events if isinstance(e.frame, Hello))
    assert hello.sensors[0].rate_hz == odr_hz
    assert hello.sensors[0].bandwidth_hz == bandwidth_hz
