"""The texts of a check: what the twin is known to lack."""

import msgspec
import pytest
from tests.support.stated_causes import stated_twin

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import RigSettings
from gyrorig_protocol.twin import Twin, twin_to_plain
from gyrorig_solver.twin_check.check_wording import unexplained_text

EFFECTS = ["on pan", "on tilt", "on the time", "on the speed", "on the move"]


def twin_without(effects: list[str]) -> tuple[Twin, str]:
    """Return a twin whose fit left these effects without a known cause, and its board."""
    plain = twin_to_plain(stated_twin(EmulatedRig(RigSettings(seed=5), 0)))
    (board,) = plain["boards"]
    plain["boards"][board]["unexplained"] = effects
    return msgspec.convert(plain, Twin), board


def test_nothing_is_stated_if_the_fit_explained_everything() -> None:
    assert unexplained_text(*twin_without([])) == ""


@pytest.mark.parametrize(
    ("count", "expected"),
    [
        (1, "depends on pan. No known cause"),
        (3, "depends on pan; on tilt; on the time. No known cause"),
        (4, "on the time; and 1 more effect. No known cause"),
        (5, "on the time; and 2 more effects. No known cause"),
    ],
)
def test_at_most_three_effects_are_listed(count: int, expected: str) -> None:
    assert expected in unexplained_text(*twin_without(EFFECTS[:count]))
