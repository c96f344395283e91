"""What is found beside reference attitudes: planted effects by their names, and no others.

The truth is made here from rotations alone: attitudes by scipy, rates as their differences over
a millisecond, a reference's smoothing as the mean of rotations, noise that is coloured and grows
with the motion as a camera's does.
"""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from tests.support.quick_cases import quick_cases

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.discover.attitude.attitude_space import AttitudeRecording
from gyrorig_solver.discover.attitude.explain_attitudes import (
    AttitudeExplanation,
    explain_attitudes,
)
from gyrorig_solver.model import RecordingContext
from gyrorig_solver.reference import read_attitude

SPAN_S, GYRO_HZ, CAMERA_HZ, LAG_S = 90.0, 200.0, 100.0, 0.004
pytestmark = pytest.mark.long

REST_S = 12.0  # at both ends
Maker = Callable[..., GyroSamples]


class Hand:
    """A board turned by hand between two rests: sums of sines, faded in and out."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._waves = [
            (self._rng.uniform(0.1, 1.0), self._rng.uniform(0.0, 6.3), self._rng.uniform(0.2, 0.6))
            for _ in range(12)
        ]

    def attitude(self, time_s: FloatArray) -> Rotation:
        """Return body into world."""
        fade = np.clip((time_s - REST_S) / 2.0, 0.0, 1.0) * np.clip(
            (SPAN_S - REST_S - time_s) / 2.0, 0.0, 1.0
        )
        fade = fade**2 * (3.0 - 2.0 * fade)
        angles = np.zeros((time_s.size, 3))
        for k, (hertz, phase, size) in enumerate(self._waves):
            angles[:, k % 3] += size * np.sin(6.2832 * hertz * time_s + phase)
        return Rotation.from_rotvec(fade[:, None] * angles)

    def rate_rad_s(self, time_s: FloatArray) -> FloatArray:
        """Return the body rate, (n, 3)."""
        before, after = self.attitude(time_s - 5e-4), self.attitude(time_s + 5e-4)
        return np.asarray((before.inv() * after).as_rotvec() / 1e-3)

    def smoothed(self, time_s: FloatArray, width_s: float) -> Rotation:
        """Return the mean attitude over a time of that standard deviation."""
        if width_s == 0.0:
            return self.attitude(time_s)
        # Gauss and Hermite's three points have a normal time's moments up to the fifth.
        at = [self.attitude(time_s + k * np.sqrt(3.0) * width_s).as_matrix() for k in (-1, 0, 1)]
        return Rotation.from_matrix((at[0] + 4.0 * at[1] + at[2]) / 6.0)

    def seen(self, time_s: FloatArray, width_s: float) -> Rotation:
        """Return what a camera says: smoothed, with errors that wander and grow with motion."""
        speed = np.linalg.norm(self.rate_rad_s(time_s), axis=1)
        white = self._rng.normal(size=(time_s.size, 3))
        wander = lfilter([0.1], [1.0, -0.95], white, axis=0) + 0.2 * white
        error = 3e-4 * (0.3 + speed)[:, None] * wander
        return self.smoothed(time_s, width_s) * Rotation.from_rotvec(error)


def explained(
    make: Maker,
    gain: FloatArray,
    seed: int,
    effect: Callable[[FloatArray, FloatArray], FloatArray] | None = None,
    width_s: float = 0.0,
    added_lag: Callable[[FloatArray], FloatArray] = np.zeros_like,
) -> AttitudeExplanation:
    """Explain a session.

    Args:
        make: makes the samples.
        gain: true gain, shape (3, 3).
        seed: of the motion and of the noise.
        effect: takes rate and force of the board to a change of the rate.
        width_s: standard deviation of the time over which the reference is smoothed.
        added_lag: takes the stamps of the samples to their lag beside the constant one, in s.
    """
    hand, rng = Hand(seed), np.random.default_rng(500 + seed)
    time_s = np.arange(int(SPAN_S * GYRO_HZ)) / GYRO_HZ
    motion_s = time_s - LAG_S - added_lag(time_s)
    rate = hand.rate_rad_s(motion_s)
    force = hand.attitude(motion_s).inv().apply([0.0, 0.0, 9.81])
    measured = rate @ gain.T + [0.01, -0.02, 0.005] + 5e-4 * rng.normal(size=rate.shape)
    if effect is not None:
        measured = measured + effect(rate, force)
    at_s = np.arange(0.5, SPAN_S - 0.5, 1.0 / CAMERA_HZ)
    reference = read_attitude(at_s, hand.seen(at_s, width_s).as_quat(), np.zeros(at_s.size))
    samples = make(time_s, measured, force)
    setting = RecordingContext(begin_s=0.0, end_s=SPAN_S)
    return explain_attitudes([AttitudeRecording("made", samples, reference, setting)])


def names(result: AttitudeExplanation) -> list[str]:
    return [cause.cause for cause in result.findings.causes]


def odd_nulls(make: Maker, gain: FloatArray, seeds: range) -> list[int]:
    """Return the seeds of sessions without any effect in which something is found."""
    return [k for k in seeds if explained(make, gain, k).findings.verdict != "adequate"]


def test_noise_that_grows_with_the_motion_is_no_cause(
    samples_of: Maker, true_gain: FloatArray
) -> None:
    """At 1 in 100 allowed, two in 4 by chance are rarer than 1 in 1000."""
    assert len(odd_nulls(samples_of, true_gain, range(4))) <= 1


@pytest.mark.bench
@pytest.mark.timeout(1200)
def test_few_of_many_nulls_are_odd(samples_of: Maker, true_gain: FloatArray) -> None:
    """At 1 in 100 allowed, four in 60 by chance are rarer than 1 in 250."""
    odd = odd_nulls(samples_of, true_gain, range(100, 160))
    assert len(odd) <= 3, odd


def test_a_smoothed_reference_is_told_from_the_gyro(
    samples_of: Maker, true_gain: FloatArray
) -> None:
    width_s = 0.012
    result = explained(samples_of, true_gain, 3, width_s=width_s)
    assert names(result) == ["reference_smoothing"]
    variance = result.findings.causes[0].values[0]
    assert abs(variance.value - width_s**2) < 3.0 * variance.std
    assert variance.std < 0.15 * width_s**2
    gain = result.findings.causes[0].gain
    assert gain is not None
    assert gain.log_likelihood.low > 0.0


def test_gravity_felt_is_named_with_its_matrix(samples_of: Maker, true_gain: FloatArray) -> None:
    k = 1.8e-4 * np.array([[1.0, -2.0, 0.5], [0.3, 1.5, -1.0], [-1.0, 0.4, 2.0]])
    result = explained(samples_of, true_gain, 4, lambda _, force: force @ k.T)
    assert names(result) == ["g_sensitivity"]
    values = result.findings.causes[0].values
    score = [(v.value - t) / v.std for v, t in zip(values, k.ravel(), strict=True)]
    assert np.sqrt(np.mean(np.square(score))) < 2.0


def test_a_bent_scale_is_named(samples_of: Maker, true_gain: FloatArray) -> None:
    size = np.array([0.0, 4e-4, 0.0])
    result = explained(samples_of, true_gain, 5, lambda rate, _: size * (rate @ true_gain.T) ** 3)
    assert names(result) == ["scale_cubic"]
    (y,) = [v for v in result.findings.causes[0].values if v.name == "coefficient.y"]
    assert abs(y.value - 4e-4) < 4.0 * y.std


def test_a_bias_of_motion_gets_no_name(samples_of: Maker, true_gain: FloatArray) -> None:
    """It is what three boards of measured data show, and no cause of the catalogue is it."""
    shift = np.array([1.0e-3, 0.6e-3, -0.5e-3])

    def moving(rate: FloatArray, _: FloatArray) -> FloatArray:
        runs: FloatArray = (np.linalg.norm(rate, axis=1) > 0.05).astype(np.float64)
        return np.outer(runs, shift)

    result = explained(samples_of, true_gain, 6, moving)
    assert names(result) == []
    rest = result.findings.unexplained
    assert rest is not None
    assert rest.leading.covariate == "moving_bias"
    assert any("on data left out" in remark for remark in result.remarks)


@pytest.mark.parametrize("cause", ["thermal_bias", "vibration_rectification", "earth_rotation"])
def test_what_cannot_be_looked_at_is_said(
    samples_of: Maker, true_gain: FloatArray, cause: str
) -> None:
    blind = {
        entry.cause: entry.reason for entry in still(samples_of, true_gain).findings.untestable
    }
    assert blind[cause]


@pytest.mark.parametrize("cause", ["backlash", "motor_coupling", "tilt_zero"])
def test_causes_of_a_unit_are_not_listed_without_one(
    samples_of: Maker, true_gain: FloatArray, cause: str
) -> None:
    untestable = still(samples_of, true_gain).findings.untestable
    assert cause not in {entry.cause for entry in untestable}


_STILL: list[AttitudeExplanation] = []


def still(make: Maker, gain: FloatArray) -> AttitudeExplanation:
    """Return one session without any effect, made once."""
    if not _STILL:
        _STILL.append(explained(make, gain, 1))
    return _STILL[0]


@pytest.mark.parametrize(
    ("seed", "rate"), quick_cases([(31, 2.5e-4), (32, -2.5e-4)], [(31, 2.5e-4)])
)
def test_a_clock_that_drifts_and_is_set_right_is_a_saw_tooth(
    samples_of: Maker, true_gain: FloatArray, seed: int, rate: float
) -> None:
    """Five corrections of 5 ms: rate and period are right, and no other cause is named."""
    period_s = 20.0

    def saw_tooth(time_s: FloatArray) -> FloatArray:
        turns = (time_s - 7.0) / period_s
        return np.asarray(rate * period_s * (turns - np.floor(turns) - 0.5))

    result = explained(samples_of, true_gain, seed, added_lag=saw_tooth)
    assert names(result) == ["clock_sawtooth"]
    values = [value.value for value in result.findings.causes[0].values]
    assert values[0] == pytest.approx(rate, rel=0.1)
    assert values[1] == pytest.approx(period_s, rel=0.03)
