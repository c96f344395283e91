"""Every cause: truth, values as findings state them, twin, and the same noise-free rates."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.support.stated_causes import BEGIN_S, END_S, STATEMENTS, stated_twin

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import PtuSettings, RigSettings
from gyrorig_daemon.emulator.injection import CAUSES, parse_injection
from gyrorig_daemon.emulator.physics.imu import SampleBlock
from gyrorig_daemon.emulator.twin import make_twin_rig

UNIT = PtuSettings(base_speed_steps_s=58, acceleration_steps_s2=3900, speed_steps_s=2400)
# One axis at a time: findings add the bias of both motors where both run, the truth does not.
MOVES = (("tilt", 2.0, -700), ("pan", 3.5, 2600), ("tilt", 6.0, 500), ("pan", 8.5, -2500),
         ("tilt", 12.0, -300), ("pan", 14.0, 900), ("tilt", 17.0, 300), ("pan", 18.0, -2000),
         ("pan", 21.0, 2600), ("tilt", 24.0, 0))  # fmt: skip
LARGEST_SHARE = 0.005  # of what the cause changes
IN_COUNTS = ("sign_flip", "axis_swap", "wrong_full_scale")  # the gain contains them
IN_STREAM = ("lost_samples", "repeated_samples", "corrupt_samples")  # they change no rate
SOAK_K = 12.0  # of thermal causes, beside the self-heating
CASES = [
    *CAUSES,
    *(f"{name}@{axis}" for name, cause in CAUSES.items() if cause.part == "ptu"
      for axis in cause.components),
    "clock_step:-0.012", "clock_skew:-3e-4", "clock_sawtooth:-2e-4", "step_resolution@pan:-3e-3",
    "low_pass_lag:-0.4", "lost_steps@pan:-8", "tilt_zero:-4e-3",
]  # fmt: skip


def settings(*hide: str, tilt_sign: int = 1) -> RigSettings:
    """Return the settings of a rig without noise."""
    return RigSettings(
        seed=5,
        ptu=replace(UNIT, tilt_sign=tilt_sign),
        injections=tuple(parse_injection(text) for text in hide),
        session_s=(BEGIN_S, END_S),
        noise_free=True,
        latitude_deg=48.0,
        heading_deg=30.0,
    )


def move(rig: EmulatedRig) -> tuple[np.ndarray, np.ndarray]:
    """Return rates and counts of a rig after `MOVES`, (n, 3) each, within the recording."""
    for name, time_s, target in MOVES:
        (rig.stage.pan if name == "pan" else rig.stage.tilt).move(time_s, target)
    (board,) = rig.boards.values()
    blocks: list[SampleBlock] = []
    while not blocks or blocks[-1].time_s[-1] < END_S:
        blocks.append(board._imu.next_block())
    recorded = np.concatenate([block.time_s for block in blocks]) >= BEGIN_S
    return (
        np.vstack([block.rate_rad_s for block in blocks])[recorded],
        np.vstack([block.gyro for block in blocks])[recorded],
    )


@cache
def plain(tilt_sign: int) -> tuple[np.ndarray, np.ndarray]:
    """Return rates and counts without a cause."""
    return move(EmulatedRig(settings(tilt_sign=tilt_sign), 0))


def twin_of(rig: EmulatedRig, tilt_sign: int = 1) -> EmulatedRig:
    """Return the emulated rig of what a fit would state of another one."""
    made = make_twin_rig(stated_twin(rig), settings(tilt_sign=tilt_sign))
    assert not made.notes
    return EmulatedRig(made.settings, 0, made.truth)


def test_every_cause_has_a_statement() -> None:
    assert set(STATEMENTS) == set(CAUSES)


def test_a_rig_without_causes_has_the_same_rates() -> None:
    rig = EmulatedRig(settings(), 0)
    rates, _ = move(rig)
    twin_rates, _ = move(twin_of(rig))
    assert np.abs(rates - twin_rates).max() < 1e-7


@pytest.mark.long
@pytest.mark.parametrize("tilt_sign", [1, -1])
@pytest.mark.parametrize("case", CASES)
def test_a_twin_has_the_noise_free_rates_of_the_truth(case: str, tilt_sign: int) -> None:
    name, _, place = case.partition(":")[0].partition("@")
    if (name, place) == ("eccentricity", "tilt"):
        pytest.skip("findings have no second harmonic on tilt, see the next test")
    if name == "eccentricity":
        case = "eccentricity@pan"
    rig = EmulatedRig(settings(case, tilt_sign=tilt_sign), 0)
    rates, counts = move(rig)
    twin = twin_of(rig, tilt_sign)
    if name in IN_STREAM:
        assert [cause.cause for cause in twin.truth.injected] == [name]
        share = rig.truth.injected[0].number("share")
        assert twin.truth.injected[0].number("share") == pytest.approx(share)
        return
    twin_rates, twin_counts = move(twin)
    if name == "bias_random_walk":
        walk = next(iter(rig.truth.boards.values())).imu.rate_random_walk
        total = next(iter(twin.truth.boards.values())).imu.rate_random_walk
        added = rig.truth.injected[0].array("walk")
        assert total == pytest.approx(np.hypot(walk, added))
        return
    if name in IN_COUNTS:
        assert np.abs(counts - twin_counts).max() <= 1
        assert np.abs(counts - plain(tilt_sign)[1]).max() > 100
        return
    effect = rates - plain(tilt_sign)[0]
    assert np.sqrt((effect**2).mean()) > 1e-7
    share = np.sqrt(((rates - twin_rates) ** 2).mean() / (effect**2).mean())
    assert share < LARGEST_SHARE


def test_the_second_harmonic_of_an_eccentric_tilt_wheel_is_not_carried_over() -> None:
    """Findings call an eccentric tilt wheel `tilt_sag`, which has one harmonic."""
    rig = EmulatedRig(settings("eccentricity@tilt"), 0)
    move(rig)
    (cause,) = rig.truth.injected
    sag = replace(
        cause,
        cause="tilt_sag",
        parameters={
            "amplitude": cause.parameters["first"],
            "phase": cause.parameters["first_phase"],
        },
    )
    rig.truth = replace(rig.truth, injected=(sag,))
    twin = twin_of(rig)
    (carried,) = twin.truth.injected
    assert carried.number("amplitude") == pytest.approx(cause.number("first"))
