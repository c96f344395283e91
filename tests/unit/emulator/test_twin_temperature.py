"""The temperature of a twin in each recording from which it was made."""

import msgspec
import pytest
from tests.support.stated_causes import stated_twin

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import RigSettings
from gyrorig_daemon.emulator.twin.twin_rig import make_twin_rig
from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.twin import TwinTemperature, parse_twin, twin_to_plain


def test_a_replay_of_a_later_recording_has_its_temperature() -> None:
    """Before, every session had the temperature of the first recording."""
    settings = RigSettings(seed=5)
    twin = stated_twin(EmulatedRig(settings, 0))
    ((name, board),) = twin.boards.items()
    first = twin.recordings[0]
    later = msgspec.structs.replace(first, name="later.mcap", begin_s=first.begin_s + 2.0)
    board = msgspec.structs.replace(
        board,
        temperature=TwinTemperature((0.0, 100.0), (25.0, 25.0)),
        later_temperatures={"later.mcap": TwinTemperature((0.0, 100.0), (30.0, 40.0))},
    )
    twin = msgspec.structs.replace(twin, recordings=(first, later), boards={name: board})
    before, after = (
        make_twin_rig(twin, settings, recording).truth.boards[name].imu.temperature_curve
        for recording in (None, "later.mcap")
    )
    assert before is not None
    assert after is not None
    assert (before.degc, after.degc) == ((25.0, 25.0), (30.0, 40.0))
    assert after.time_s[0] - before.time_s[0] == pytest.approx(-2.0)
    document = {"schema": "gyrorig/rig/1", "twin": twin_to_plain(twin)}
    read = parse_twin(dump_yaml(document).encode(), "twin.yaml")
    assert read.boards[name].later_temperatures == board.later_temperatures
