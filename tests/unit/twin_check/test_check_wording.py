"""The texts of a check: what the twin is known to lack."""

from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from tests.support.stated_causes import stated_twin

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import RigSettings
from gyrorig_protocol.twin import Scalar, Twin, TwinCause, twin_to_plain
from gyrorig_solver.twin_check.check_wording import (
    differences,
    lack_texts,
    single_event_text,
    unexplained_text,
)
from gyrorig_solver.twin_check.gain_wording import gain_text

EFFECTS = ["on pan", "on tilt", "on the time", "on the speed", "on the move"]


def twin_without(effects: list[str]) -> tuple[Twin, str]:
    """Return a twin whose fit left these effects without a known cause, and its board."""
    plain = twin_to_plain(stated_twin(EmulatedRig(RigSettings(seed=5), 0)))
    (board,) = plain["boards"]
    plain["boards"][board]["unexplained"] = effects
    return msgspec.convert(plain, Twin), board


def test_nothing_is_stated_if_the_fit_explained_everything() -> None:
    assert lack_texts(*twin_without([]), True) == []


def test_a_random_cause_of_the_board_limits_what_the_check_can_see() -> None:
    """Its draws differ as much from each other as from a measurement with a similar effect."""
    twin, board = twin_without([])
    random = TwinCause(
        "bias_random_walk", "x", {"factor.x": Scalar(30.0, 2.0, "1", "recording")}, board
    )
    stated = lack_texts(msgspec.structs.replace(twin, causes=(random,)), board, True)
    assert len(stated) == 1
    assert (
        "bias_random_walk (x): the check cannot see any other slow change of the bias" in stated[0]
    )
    others = msgspec.structs.replace(random, board="OTHER")
    assert lack_texts(msgspec.structs.replace(twin, causes=(others,)), board, True) == []


def test_a_single_event_is_stated_for_a_new_recording_only() -> None:
    twin, board = twin_without([])
    step = {"step.x": Scalar(0.1, 0.01, "rad/s"), "time": Scalar(3.0, 0.1, "s")}
    event = TwinCause("bias_step", "x", step, board, "fitted.mcap")
    twin = msgspec.structs.replace(twin, causes=(event,))
    (stated,) = lack_texts(twin, board, True)
    assert stated.endswith("not repeated: bias_step in fitted.mcap.")
    assert lack_texts(twin, board, False) == []
    assert single_event_text(twin, "OTHER", True) == ""


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


def held_out(*gains_and_shares: tuple[float, float | None]) -> Any:
    """Return what a check states of boards with these gains and shares."""
    boards = [
        SimpleNamespace(
            gain_nats_per_s=gain, recovered_share=share, calibration_gain_nats_per_s=gain
        )
        for gain, share in gains_and_shares
    ]
    return SimpleNamespace(held_out=boards, twin=SimpleNamespace(causes=()))


def test_several_shares_are_a_range() -> None:
    """Before, the mean gain was stated to be the smallest share."""
    text = gain_text(held_out((4e4, 0.9999), (2e4, 0.98)))
    assert "improves by 3e+04 nats per second; of the difference" in text
    assert "recovers 98.00 % to 99.99 %" in text


def test_a_loss_is_no_improvement() -> None:
    text = gain_text(held_out((-5.0, None)))
    assert "falls by 5 nats per second." in text
    assert "All of this gain" not in text


def test_rare_events_neither_differ_nor_count() -> None:
    """Their p-value has the rank only, so it cannot reach the limit."""
    comparisons = [
        SimpleNamespace(
            family=SimpleNamespace(is_of_rare_events=rare), p_value=p_value, distance=1.0
        )
        for rare, p_value in ((True, 1e-9), (False, 0.004), (False, 0.003))
    ]
    stage: Any = SimpleNamespace(comparisons=comparisons)
    assert [comparison.p_value for comparison in differences(stage)] == [0.003]
