"""Wrong turns in an import map: signs, mirrored axes, angles, and sections that cut a turn."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tests.unit.references.test_turns_fit import Maker, turning

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import GyroFit, fit_turns
from gyrorig_solver.reference import TimeInterval, TurnReference
from gyrorig_solver.reference.known_turns import KnownTurn

AXES = np.vstack([np.eye(3), -np.eye(3)])
Change = Callable[[int, KnownTurn], KnownTurn]


@pytest.fixture
def session(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> tuple[GyroSamples, TurnReference]:
    return turning(samples_of, true_gain, true_bias_rad_s, AXES, None)


def fit_changed(session: tuple[GyroSamples, TurnReference], change: Change) -> GyroFit:
    samples, reference = session
    turns = tuple(change(k, turn) for k, turn in enumerate(reference.turns))
    return fit_turns([(samples, replace(reference, turns=turns))])


def reasons_of(fit: GyroFit) -> str:
    return " ".join((*fit.limited_reasons, *fit.observability.reasons))


def test_true_turns_get_no_reason(session: tuple[GyroSamples, TurnReference]) -> None:
    fit = fit_changed(session, lambda _, turn: turn)
    assert all(text.startswith("not identified: time offset") for text in fit.limited_reasons)
    assert not any("section" in text or "times in the file" in text for text in fit.warnings)


def test_a_wrong_sign_is_a_reason(session: tuple[GyroSamples, TurnReference]) -> None:
    """Before, the scale factors were -1.01 ± 0.0005 without any message."""
    fit = fit_changed(session, lambda _, turn: replace(turn, angle_rad=-turn.angle_rad))
    assert np.all(fit.scale < 0.0)
    assert "6 of 6 turns have the opposite direction in the gyro: at 5.0 s -360 deg" in reasons_of(
        fit
    )


def test_mirrored_axes_are_a_reason(session: tuple[GyroSamples, TurnReference]) -> None:
    swapped = fit_changed(session, lambda _, turn: replace(turn, axis=turn.axis[[1, 0, 2]]))
    assert "mirror image" in reasons_of(swapped)
    permuted = fit_changed(session, lambda _, turn: replace(turn, axis=turn.axis[[1, 2, 0]]))
    assert "mirror image" not in reasons_of(permuted)


def test_a_wrong_angle_is_named(
    session: tuple[GyroSamples, TurnReference], true_gain: FloatArray
) -> None:
    """Before: "the recordings have no turn about the y axis of the reference; add one"."""
    fit = fit_changed(
        session, lambda k, turn: replace(turn, angle_rad=turn.angle_rad * (1.5 if k == 1 else 1.0))
    )
    text = reasons_of(fit)
    assert "the stated turns contradict each other" in text
    named = re.search(r"at 14\.0 s \+540 deg are stated and the gyro turned by (\S+) deg", text)
    assert named is not None
    assert float(named[1]) == pytest.approx(360.0 * np.linalg.norm(true_gain[:, 1]), rel=1e-3)
    assert "no turn about" not in text


def test_a_cut_turn_is_a_remark(session: tuple[GyroSamples, TurnReference]) -> None:
    def cut(_: int, turn: KnownTurn) -> KnownTurn:
        interval = TimeInterval(turn.interval.begin_s + 1.0, turn.interval.end_s)
        return replace(turn, interval=interval, std_rad=1e-3)

    remark = "turns at the begin or at the end of 6 of 6 turns"
    assert any(remark in text for text in fit_changed(session, cut).warnings)


@pytest.mark.parametrize("skew_ppm", [0.0, -12_695.0])
def test_times_that_nothing_checks_are_a_remark(
    session: tuple[GyroSamples, TurnReference], skew_ppm: float
) -> None:
    samples, reference = session
    clock = replace(samples.clock, skew_ppm=skew_ppm)
    fit = fit_turns([(replace(samples, metadata={"link": "file"}, clock=clock), reference)])
    is_warned = any("as accurate as the times in the file" in text for text in fit.warnings)
    assert is_warned == (skew_ppm == 0.0)
