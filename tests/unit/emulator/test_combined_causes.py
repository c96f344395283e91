"""Causes that act together: one does not make another larger than physics allows."""

import numpy as np
import pytest
from tests.hidden.truth.draws import LINES, make_sizer
from tests.hidden.truth.session import RigDraw

from gyrorig_daemon.emulator.emulator_settings import InjectionRequest

# The program of this rig starts its moves at the base speed of the motors.
RIG = RigDraw(77, "quick", 0.0, *LINES[3])
COMPLIANCE = InjectionRequest("base_compliance", "pan", 1.5e-4)
JUMP = InjectionRequest("base_speed_jump", "", 0.07)
MOST_TOGETHER = 0.05  # of the compliance's largest effect


@pytest.mark.long
@pytest.mark.parametrize(
    ("cause", "size"),
    [
        ("scale_quadratic", 1e-3),
        ("scale_cubic", 1e-3),
        ("scale_asymmetry", 2e-3),
        ("vibration_rectification", 1e-3),
    ],
)
def test_a_non_linear_term_does_not_act_on_the_spikes_of_a_stiff_base(
    cause: str, size: float
) -> None:
    sizer = make_sizer(RIG)
    other = InjectionRequest(cause, "", size)

    def effect(*orders: InjectionRequest) -> np.ndarray:
        return sizer.simulate_rates(*orders).hidden_rad_s - sizer.simulate_rates(JUMP).hidden_rad_s

    spikes = effect(JUMP, COMPLIANCE)
    together = effect(JUMP, COMPLIANCE, other) - spikes - effect(JUMP, other)
    assert np.abs(together).max() < MOST_TOGETHER * np.abs(spikes).max()
