"""What the finder says of a recording without the bandwidth of the sensor's low-pass.

The authority is the emulated rig: its boards have a low-pass, and it hides nothing else.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.support.board_fits import explain_recordings

from gyrorig_protocol.recording.recording import Recording

CONFIG = Path(__file__).resolve().parents[3] / "config" / "rig.yaml"
FAR = 4.0  # standard deviations: one in 16 000
SIGNALS_RIG = """
schema: gyrorig/rig/1
rig: can-signals
ptu: {port: emulated, baud: 9600}
buses: [{id: can0, port: emulated}]
boards:
  - id: MTLT-1
    bus: can0
    format: signals
    signals: {preset: j1939, source_address: 128}
    facts: {uid: MTLT-1-by-hand, odr_hz: 100.0}
emulator: {seed: 1}
"""


def without_bandwidth(recording: Recording, board: str) -> Recording:
    """Return a recording whose board states no bandwidth."""
    key = f"gyrorig.board.{board}"
    board_metadata = dict(recording.metadata[key])
    board_metadata.pop("bandwidth_hz", None)
    return replace(recording, metadata={**recording.metadata, key: board_metadata})


@pytest.fixture(scope="module")
def rig_200_hz(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig whose board has two samples in a block mean, and a bandwidth of 12.5 Hz."""
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    text = CONFIG.read_text(encoding="utf-8").replace("odr_hz: 100", "odr_hz: 200")
    path.write_text(text.replace("bandwidth_hz: 25.0", "bandwidth_hz: 12.5"), encoding="utf-8")
    return path


def check_only_the_low_pass(session: Any, true_period_s: float) -> None:
    """Check that the low-pass is the only cause, and that its cut-off is right."""
    recording = without_bandwidth(session.recording, session.board)
    findings = explain_recordings([recording], session.board).findings
    (cause,) = findings.causes
    assert cause.candidates == ("low_pass_lag",)
    (period,) = cause.values
    assert (period.name, period.unit) == ("period", "s")
    assert period.value is not None
    assert period.std is not None
    assert abs(period.value - true_period_s) < FAR * period.std
    assert f"{1.0 / period.value:.3g} Hz" in cause.sentence
    assert findings.unexplained is None


@pytest.mark.long
def test_only_the_low_pass_is_named(hidden: Callable[..., Any]) -> None:
    check_only_the_low_pass(hidden(seed=11), 1.0 / 25.0)


@pytest.mark.long
def test_only_the_low_pass_is_named_at_200_hz(hidden: Callable[..., Any], rig_200_hz: Path) -> None:
    check_only_the_low_pass(hidden(seed=11, config=rig_200_hz), 1.0 / 12.5)


@pytest.fixture(scope="module")
def rig_without_timestamps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig whose board is an IMU of the preset j1939, which sends no timestamps."""
    path = tmp_path_factory.mktemp("can") / "rig.yaml"
    path.write_text(SIGNALS_RIG, encoding="utf-8")
    return path


@pytest.mark.long
def test_only_the_low_pass_is_named_without_timestamps(
    hidden: Callable[..., Any], rig_without_timestamps: Path
) -> None:
    """Before, the jitter of the arrivals hid the shape of the edges, and s_curve was named."""
    check_only_the_low_pass(hidden(seed=1, config=rig_without_timestamps), 1.0 / 25.0)
