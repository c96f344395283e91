"""What `make kill` ends with: 1 too where more is lost than docs/recordings.md states."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.bench.kill_recordings import LIMIT_S, Kill, report

SOUND = Kill("recovered", 0.3, 800)


@pytest.mark.parametrize(
    ("kills", "code"),
    [
        ([SOUND, Kill("recovered", LIMIT_S, 800)], 0),
        ([SOUND, Kill("closed", None, 800)], 0),
        ([SOUND, Kill("recovered", LIMIT_S + 0.01, 800)], 1),
        ([SOUND, Kill("no whole chunk yet", LIMIT_S + 0.01, 0)], 1),
        ([SOUND, Kill("recovered", None, 800, "a gap in the daemon's own numbers")], 1),
        ([], 1),
    ],
)
def test_the_exit_status_of_the_report(
    kills: list[Kill], code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert report(kills) == code
    assert f"{len(kills)} kills" in capsys.readouterr().out
