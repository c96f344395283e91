"""Quaternions of another convention are refused with the proof, and what to set in the map."""

import numpy as np
import pytest
from tests.support.quick_cases import quick_cases
from tests.support.simulated_attitudes import HandMotion, StampSettings, simulate_attitudes
from tests.support.simulated_samples import plain_samples

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import fit_attitude
from gyrorig_solver.estimate.attitude.attitude_conventions import judge_conventions
from gyrorig_solver.reference import AttitudeReference, read_attitude

CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])
EXACT = StampSettings()
AS_XYZW = [3, 0, 1, 2]  # wxyz, read as xyzw
AS_WXYZ = [1, 2, 3, 0]  # xyzw, read as wxyz


def session(
    speed: float, settings: StampSettings = EXACT
) -> tuple[GyroSamples, FloatArray, FloatArray]:
    made = simulate_attitudes(1, settings, motion=HandMotion(1, speed), span_s=40.0)
    return plain_samples(made.gyro_time_s, made.gyro_rad_s), made.stamp_s, made.orientation_xyzw


def reference(stamp_s: FloatArray, orientation_xyzw: FloatArray) -> AttitudeReference:
    return read_attitude(stamp_s, orientation_xyzw, np.full(stamp_s.size, np.nan))


@pytest.mark.parametrize("speed", quick_cases([1.0, 0.1], [0.1]))
def test_wrong_conventions_are_refused_with_the_right_one(speed: float) -> None:
    samples, stamp_s, q = session(speed, StampSettings(2e-3, "arrival", outlier_share=0.01))
    for wrong, meaning, remedy in (
        (q * CONJUGATE, "map world to body: conjugated", "Change `maps`"),
        (q[:, AS_XYZW], "the order wxyz: read as wxyz", "Set `order: wxyz`"),
        (q[:, AS_WXYZ], "the order xyzw: read as xyzw", "Set `order: xyzw`"),
    ):
        with pytest.raises(InputError, match=meaning) as refused:
            fit_attitude([(samples, reference(stamp_s, wrong))])
        assert remedy in str(refused.value)
        assert "they agree with the gyro to" in str(refused.value)


def test_an_order_that_turns_the_mount_is_a_remark() -> None:
    samples, stamp_s, q = session(1.0)
    fit = fit_attitude([(samples, reference(stamp_s, (q * CONJUGATE)[:, AS_WXYZ]))])
    assert "the sensor is turned by 90 deg" in " ".join(fit.warnings)
    assert fit_attitude([(samples, reference(stamp_s, q))]).warnings == ()


def test_attitudes_of_another_motion_are_refused() -> None:
    samples, stamp_s, _ = session(1.0)
    other = simulate_attitudes(7, span_s=40.0).orientation_xyzw
    with pytest.raises(InputError, match="do not show the motion of the gyro"):
        fit_attitude([(samples, reference(stamp_s, other))])


def test_the_right_reading_is_first_and_decided() -> None:
    samples, stamp_s, q = session(0.3)
    judgement = judge_conventions(samples, reference(stamp_s, q))
    assert judgement is not None
    assert judgement.residuals[0].reading == "as recorded"
    assert judgement.is_decided
    assert not judgement.is_wrong


@pytest.mark.parametrize(
    ("ratio", "unit"), [(np.degrees(1.0), "in deg/s"), (np.radians(1.0), "in rad/s")]
)
def test_a_wrong_unit_of_the_rates_is_refused(ratio: float, unit: str) -> None:
    """Before, the reasons were "the board hardly turned" and "the rate never changed"."""
    samples, stamp_s, q = session(1.0)
    wrong = plain_samples(samples.time_s, samples.rate_rad_s * ratio)
    with pytest.raises(InputError, match=f"times as fast as .*as if its rates are {unit}"):
        fit_attitude([(wrong, reference(stamp_s, q))])


def test_a_clock_that_is_two_percent_off_is_named() -> None:
    """Before, the reason was a difference of the times by 27.49 s, which is not true."""
    samples, stamp_s, q = session(1.0)
    with pytest.raises(InputError, match="so their clocks run at different speeds"):
        fit_attitude([(samples, reference(stamp_s * 1.02, q))])
