"""The fit against reference attitudes: known truth, coverage over seeds, odd input."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.support.rotation_error import window_rotation_error

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import fit_attitude
from gyrorig_solver.reference import AttitudeReference, read_attitude

LAG_S = 0.0071
Maker = Callable[..., GyroSamples]


def session(
    motion: object,
    make: Maker,
    gain: FloatArray,
    bias: FloatArray,
    seed: int,
    angle_noise_rad: float,
    rate_noise_rad_s: float,
    reference_hz: float = 120.0,
    gyro_hz: float = 200.0,
    span_s: float = 60.0,
) -> tuple[GyroSamples, AttitudeReference]:
    rng = np.random.default_rng(1000 + seed)
    time_s = np.arange(int(span_s * gyro_hz)) / gyro_hz
    true = motion.rate_rad_s(time_s - LAG_S)  # type: ignore[attr-defined]
    rate = true @ gain.T + bias + rng.normal(size=true.shape) * rate_noise_rad_s
    at_s = np.arange(0.1, span_s - 0.1, 1.0 / reference_hz)
    noise = Rotation.from_rotvec(rng.normal(size=(at_s.size, 3)) * angle_noise_rad)
    q = (motion.attitude(at_s) * noise).as_quat()  # type: ignore[attr-defined]
    return make(time_s, rate), read_attitude(at_s, q, np.full(at_s.size, np.nan))


@pytest.mark.long
@pytest.mark.parametrize(
    ("angle_noise_rad", "rate_noise_rad_s"),
    [(1e-3, 1e-3), (1e-5, 2e-2)],
    ids=["noisy reference", "noisy gyro"],
)
def test_errors_are_what_the_covariance_says(
    tumble: Callable[[int], object],
    samples_of: Maker,
    true_gain: FloatArray,
    true_bias_rad_s: FloatArray,
    angle_noise_rad: float,
    rate_noise_rad_s: float,
) -> None:
    scores, lags = [], []
    for seed in range(8):
        attitude_session = session(
            tumble(seed),
            samples_of,
            true_gain,
            true_bias_rad_s,
            seed,
            angle_noise_rad,
            rate_noise_rad_s,
        )
        fit = fit_attitude([attitude_session])
        assert fit.identified
        scores.append(((fit.gain - true_gain) / fit.gain_std).ravel())
        scores.append((fit.bias_rad_s - true_bias_rad_s) / [fit.std[f"bias.{k}"] for k in "xyz"])
        lags.append((fit.time_offset_s - LAG_S) / fit.std["time_offset"])
    every = np.concatenate([*scores, lags])
    # 104 scores of unit variance: chi-square within about five of its deviations.
    assert 0.4 < np.mean(every**2) < 1.7
    assert np.abs(every).max() < 4.5


def test_a_noisy_reference_does_not_pull_the_gain_down(
    tumble: Callable[[int], object],
    samples_of: Maker,
    true_gain: FloatArray,
    true_bias_rad_s: FloatArray,
) -> None:
    attitude_session = session(tumble(3), samples_of, true_gain, true_bias_rad_s, 3, 8e-3, 1e-4)
    fit = fit_attitude([attitude_session])
    # Differentiated, 8 mrad at 120 Hz is 1.4 rad/s of noise: least squares of y on it
    # would lose most of the gain.
    assert np.abs(fit.gain - true_gain).max() < 5.0 * fit.gain_std.max() < 0.05


def test_gaps_glitches_and_two_recordings(
    tumble: Callable[[int], object],
    samples_of: Maker,
    true_gain: FloatArray,
    true_bias_rad_s: FloatArray,
) -> None:
    both = []
    for seed in (4, 5):
        samples, reference = session(
            tumble(seed), samples_of, true_gain, true_bias_rad_s, seed, 2e-4, 5e-4
        )
        q = reference.orientation_xyzw.copy()
        q[1000:1100] = np.nan
        q[3000] = Rotation.from_rotvec([0.0, 0.0, 1.0]).as_quat()
        both.append((samples, read_attitude(reference.time_s, q, np.zeros(q.shape[0]))))
    fit = fit_attitude(both)
    assert fit.outliers > 0
    assert np.abs((fit.gain - true_gain) / fit.gain_std).max() < 4.5
    assert fit.rms_after_rad_s < 0.2 * fit.rms_before_rad_s


def test_one_axis_shows_one_column(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    rng = np.random.default_rng(9)
    time_s = np.arange(8000) / 200.0
    at_s = np.arange(0.0, 40.0, 0.01)

    def angle(t: FloatArray) -> FloatArray:
        return np.asarray(1.5 * np.sin(2.0 * t) + 0.4 * np.sin(7.0 * t))

    rate = np.zeros((time_s.size, 3))
    rate[:, 2] = 3.0 * np.cos(2.0 * time_s) + 2.8 * np.cos(7.0 * time_s)
    measured = rate @ true_gain.T + true_bias_rad_s + rng.normal(size=rate.shape) * 1e-3
    turn = np.zeros((at_s.size, 3))
    turn[:, 2] = angle(at_s)
    noise = Rotation.from_rotvec(rng.normal(size=turn.shape) * 1e-4)
    q = (Rotation.from_rotvec(turn) * noise).as_quat()
    fit = fit_attitude(
        [(samples_of(time_s, measured), read_attitude(at_s, q, np.zeros(at_s.size)))]
    )
    assert np.all(np.isnan(fit.gain[:, :2]))
    assert np.abs((fit.gain[:, 2] - true_gain[:, 2]) / fit.gain_std[:, 2]).max() < 4.5
    assert not fit.identified
    assert any("column x" in text for text in fit.observability.reasons)


def test_no_common_stretch_is_refused(samples_of: Maker) -> None:
    time_s = np.arange(1000) / 100.0
    q = np.tile([0.0, 0.0, 0.0, 1.0], (500, 1))
    reference = read_attitude(100.0 + np.arange(500) / 100.0, q, np.zeros(500))
    with pytest.raises(InputError, match="do not overlap in time"):
        fit_attitude([(samples_of(time_s, np.zeros((1000, 3))), reference)])


def test_invalid_attitudes_are_rejected() -> None:
    time_s = np.arange(10.0)
    q = np.tile([0.0, 0.0, 0.0, 1.0], (10, 1))
    with pytest.raises(InputError, match="recording is a quaternion of length 1"):
        read_attitude(time_s, 3.0 * q, np.zeros(10))
    with pytest.raises(InputError, match="do not increase"):
        read_attitude(time_s[::-1], q, np.zeros(10))


def test_the_window_error_is_the_residual_angle(
    tumble: Callable[[int], object], samples_of: Maker
) -> None:
    motion = tumble(6)
    time_s = np.arange(4000) / 200.0
    rate = motion.rate_rad_s(time_s)  # type: ignore[attr-defined]
    at_s = np.arange(0.5, 19.0, 0.01)
    reference = read_attitude(at_s, motion.attitude(at_s).as_quat(), np.zeros(at_s.size))  # type: ignore[attr-defined]
    exact = window_rotation_error(time_s, rate, reference)
    assert exact.rms_rad < 2e-6
    assert exact.angle_rad.size == 18
    # A bias of 10 mrad/s about one axis turns 10 mrad in a second, whatever the motion.
    biased = window_rotation_error(time_s, rate + np.array([0.01, 0.0, 0.0]), reference)
    assert 0.007 < biased.rms_rad <= 0.0101
    low, high = biased.interval_rad
    assert low <= biased.rms_rad <= high
    use = at_s > 10.0
    assert window_rotation_error(time_s, rate, reference, 1.0, use).begin_s.min() > 10.0
    with pytest.raises(InputError, match="no common window of 60 s"):
        window_rotation_error(time_s, rate, reference, 60.0)
