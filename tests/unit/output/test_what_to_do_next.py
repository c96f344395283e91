"""Errors of the solver say what is wrong and what to do: a few that once did not."""

import errno
from pathlib import Path

import msgspec
import pytest
import yaml

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver import cli
from gyrorig_solver.apply.calibration_correction import build_correction
from gyrorig_solver.calibration import parse_calibration
from gyrorig_solver.estimate.noise.noise_model import Sampling
from gyrorig_solver.estimate.series import too_short_error
from gyrorig_solver.plan import load_rig
from gyrorig_solver.storage import Folder

GOLDEN = Path(__file__).parent / "golden" / "good.yaml"
Captured = pytest.CaptureFixture[str]


def test_a_gain_of_two_axes_asks_for_a_motion_about_three() -> None:
    plain = yaml.safe_load(GOLDEN.read_text())
    calibration = parse_calibration(yaml.safe_dump(plain), "good")
    flat = msgspec.structs.replace(
        calibration.matrices, STM=[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]]
    )
    with pytest.raises(
        InputError, match=r"measure the same rate\. Record a motion about all three"
    ):
        build_correction(msgspec.structs.replace(calibration, matrices=flat))


def test_a_file_that_is_gone_meanwhile(tmp_path: Path) -> None:
    with (
        pytest.raises(InputError, match="was removed while the program ran"),
        Folder(tmp_path).local_copy("a.mcap"),
    ):
        pass


def test_too_short_says_how_long() -> None:
    message = str(too_short_error(Sampling(100.0, 8, None, 0.0, differentiated=False)))
    assert (
        "has no 0.64 s of samples without an interruption. Record for longer. Interruptions are"
        in message
    )


def test_a_rig_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"No such file or directory\)\. Give a rig file, such as"):
        load_rig(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("number", "says"),
    [
        (errno.ENOENT, "Give a name that exists."),
        (errno.ENOSPC, "Free some space on its disk."),
        (errno.EIO, "Check the disk and the permissions."),
    ],
)
def test_what_the_computer_refuses_has_a_remedy(
    number: int, says: str, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(number, "so it is", "/a/file")

    monkeypatch.setattr(cli.cli, "main", refuse)
    assert cli.run(["check", "x.mcap"]) == 1
    errors = capsys.readouterr().err
    assert errors.startswith("gyrorig: /a/file cannot be used (so it is). ")
    assert says in errors
