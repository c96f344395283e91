"""What a recording says of itself is hostile: one clear refusal, or it does not matter."""

from dataclasses import replace
from pathlib import Path

import pytest

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.reference import read_pan_tilt_reference

KEYS = (
    ("gyrorig.ptu", "baud"),
    ("gyrorig.ptu", "counter_hz"),
    ("gyrorig.ptu", "pan_resolution_arcsec"),
    ("gyrorig.ptu", "pan_base_speed"),
    ("gyrorig.ptu", "tilt_acceleration"),
    ("gyrorig.board.GY80-P4242", "gyro_scale_rad_s"),
    ("gyrorig.board.GY80-P4242", "tick_hz"),
    ("gyrorig.board.GY80-P4242", "counter_bits"),
    ("gyrorig.board.GY80-P4242", "bandwidth_hz"),
    ("gyrorig.board.GY80-P4242", "temperature_scale_c"),
)


@pytest.mark.parametrize(("section", "key"), KEYS)
@pytest.mark.parametrize("text", ["", "0", "-5", "nan", "1e400", "x" * 500])
def test_any_text_is_read_or_refused_in_one_line(
    contracts: Path, section: str, key: str, text: str
) -> None:
    recording = read_recording(contracts / "sample.mcap")
    changed = {name: dict(entries) for name, entries in recording.metadata.items()}
    changed[section][key] = text
    hostile = replace(recording, metadata=changed)
    message = ""
    try:
        samples = load_samples(hostile, "GY80-P4242")
        read_pan_tilt_reference(hostile, samples.origin_ns)
    except GyrorigError as refused:
        message = str(refused)
    assert "\n" not in message
    assert len(message) < 200
