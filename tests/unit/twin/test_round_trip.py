"""An emulated rig, its recording, and the twin of the recording against the rig's truth."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
import yaml
from tests.support.twin_truth import compare_twin
from tests.unit.twin.conftest import COMMAND_TIME_S, RecordedTwin

from gyrorig_daemon.config import parse_rig
from gyrorig_protocol.twin import find_quantity

pytestmark = pytest.mark.long

FARTHEST_SIGMA = 4.0
TWO_BOARDS = """
schema: gyrorig/rig/1
rig: two-boards
ptu: {port: emulated, baud: 115200}
boards:
  - {id: A-1, port: emulated, baud: 460800}
  - {id: B-2, port: emulated, baud: 230400}
emulator: {dialect: e46, command_time_ms: 5.0, odr_hz: 100, bandwidth_hz: 25.0}
"""


@pytest.fixture(scope="module")
def hidden(recorded_twin: Callable[..., RecordedTwin]) -> RecordedTwin:
    """The twin of a rig with backlash and a bias that steps."""
    causes = ("backlash@pan:0.0015", "bias_step:0.02")
    options = [word for cause in causes for word in ("--hide", cause)]
    return recorded_twin("--seed", "21", *options)


def test_the_measured_values_are_near_the_truth(hidden: RecordedTwin) -> None:
    deviations = list(compare_twin(hidden.twin, hidden.truth, COMMAND_TIME_S))
    assert len(deviations) > 25
    # What backlash and a step change of these is in the causes.
    base = [d for d in deviations if "bias" not in d.name]
    assert [d for d in base if abs(d.sigma) > FARTHEST_SIGMA] == []


def test_every_cause_is_in_the_twin_as_in_the_findings(hidden: RecordedTwin) -> None:
    causes = {cause.cause: cause for cause in hidden.twin.causes}
    assert set(causes) == {"backlash", "bias_step"}
    gap = causes["backlash"].parameters["gap.pan"]
    assert gap.std is not None
    assert abs(gap.value - 0.0015) < FARTHEST_SIGMA * gap.std
    assert causes["backlash"].board is None
    assert causes["bias_step"].board == "GY80-1"


def test_the_daemon_reads_the_file(hidden: RecordedTwin) -> None:
    text = hidden.file.read_bytes()
    document = yaml.safe_load(text)
    assert document.pop("twin")["schema"] == "gyrorig/twin/1"
    rig = parse_rig(yaml.safe_dump(document), "twin.yaml")
    assert rig.is_emulated
    assert [board.id for board in rig.boards] == ["GY80-1"]
    assert rig.emulator.bandwidth_hz == pytest.approx(25.0)


def test_the_joint_covariance_has_the_stated_deviations(hidden: RecordedTwin) -> None:
    twin = hidden.twin
    assert twin.posterior is not None
    covariance = np.array(twin.posterior.covariance)
    scale = np.sqrt(np.diag(covariance))
    assert np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() > -1e-6
    for name, std in zip(twin.posterior.names, scale, strict=True):
        located = find_quantity(twin, name)
        assert located is not None
        quantity, index = located
        stated = np.array(quantity.std)[index]
        if name.endswith(("time_offset", "start_delay")):
            # Only the sum of both shows in the data, so that a draw keeps it.
            assert std < 0.1 * stated
        elif name.startswith("boards"):
            assert std == pytest.approx(stated, rel=1e-6), name
        else:
            assert std == pytest.approx(stated, rel=0.2), name
    assert any(name.endswith(".gap.pan") for name in twin.posterior.names)


@cache
def _two_boards(make: Callable[..., RecordedTwin]) -> RecordedTwin:
    return make("--seed", "4", "--hide", "eccentricity@pan:0.004", rig=TWO_BOARDS)


def test_boards_on_one_unit_make_one_twin(recorded_twin: Callable[..., RecordedTwin]) -> None:
    made = _two_boards(recorded_twin)
    twin = made.twin
    assert list(twin.boards) == ["A-1", "B-2"]
    far = [d for d in compare_twin(twin, made.truth, COMMAND_TIME_S) if abs(d.sigma) > 4.0]
    assert far == []
    (cause,) = twin.causes
    assert (cause.cause, cause.board) == ("eccentricity", None)
    assert twin.posterior is not None
    names = twin.posterior.names
    covariance = np.array(twin.posterior.covariance)
    unit = [k for k, name in enumerate(names) if name.startswith("causes.0.")]
    assert unit
    # Through the cause of the unit the gains of both boards depend on each other.
    first, second = (names.index(f"boards.{board}.gain.2.2") for board in ("A-1", "B-2"))
    assert covariance[first, second] != 0.0


def test_the_devices_are_those_of_the_recording(
    recorded_twin: Callable[..., RecordedTwin],
) -> None:
    rig = yaml.safe_load(_two_boards(recorded_twin).file.read_text("utf-8"))
    assert rig["rig"] == "two-boards"
    assert [board["baud"] for board in rig["boards"]] == [460800, 230400]
    assert rig["ptu"] == {"port": "emulated", "baud": 115200}
