"""Gravity between rests: known truth, coverage over seeds, what it refuses."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import GyroFit, fit_gravity
from gyrorig_solver.estimate.gravity_fit import describe_excess, detectable_ratio
from gyrorig_solver.estimate.gravity_mismatch import list_mismatches
from gyrorig_solver.reference import TimeInterval, find_poses
from gyrorig_solver.reference.gravity_reference import calibrate_accelerometer

Maker = Callable[..., GyroSamples]
GRAVITY = 9.81
# reading = U^-1 force + offset, U upper triangular as the frame's definition wants it.
TRUE_U = np.array([[1.013, -0.008, 0.005], [0.0, 0.991, 0.012], [0.0, 0.0, 1.004]])
OFFSET = np.array([0.11, -0.23, 0.07])


def handheld(
    make: Maker,
    gain: FloatArray,
    bias: FloatArray,
    seed: int,
    moves: int = 30,
    axes: FloatArray | None = None,
    rate_noise_rad_s: float = 3e-3,
) -> GyroSamples:
    """Rests of 3 s with smooth turns of 2 s by about a radian between them."""
    rng = np.random.default_rng(seed)
    hz = 100.0
    attitude, rates, ups = Rotation.random(random_state=seed), [], []
    up = np.array([0.0, 0.0, 1.0])
    rates.append(np.zeros((1200, 3)))
    ups.append(np.tile(attitude.inv().apply(up), (1200, 1)))
    for k in range(moves):
        axis = rng.normal(size=3) if axes is None else axes[k % len(axes)]
        axis = axis / np.linalg.norm(axis)
        size = rng.uniform(0.7, 1.6) * rng.choice([-1.0, 1.0])
        phase = np.arange(201) / 200.0
        angle = size * (phase - np.sin(2 * np.pi * phase) / (2 * np.pi))
        speed = size / 2.0 * (1.0 - np.cos(2 * np.pi * phase))
        along = attitude * Rotation.from_rotvec(angle[:-1, None] * axis)
        ups.append(along.inv().apply(up))
        rates.append(speed[:-1, None] * axis)
        attitude = attitude * Rotation.from_rotvec(size * axis)
        rates.append(np.zeros((300, 3)))
        ups.append(np.tile(attitude.inv().apply(up), (300, 1)))
    rate, force = np.concatenate(rates), GRAVITY * np.concatenate(ups)
    shake = np.where(np.linalg.norm(rate, axis=1) > 0.0, 0.4, 0.01)[:, None]
    accel = force @ np.linalg.inv(TRUE_U).T + OFFSET + rng.normal(size=force.shape) * shake
    measured = rate @ gain.T + bias + rng.normal(size=rate.shape) * rate_noise_rad_s
    return make(np.arange(len(rate)) / hz, measured, accel)


def test_accelerometer_is_found_from_exact_poses() -> None:
    force = GRAVITY * Rotation.random(20, random_state=1).apply([0.0, 0.0, 1.0])
    result = calibrate_accelerometer(force @ np.linalg.inv(TRUE_U).T + OFFSET, GRAVITY)
    np.testing.assert_allclose(result.matrix, TRUE_U, atol=1e-9)
    np.testing.assert_allclose(result.offset_m_s2, OFFSET, atol=1e-8)
    assert result.residual_m_s2 < 1e-9
    assert result.condition < 100.0


def test_rests_are_found_where_they_are(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    samples = handheld(samples_of, true_gain, true_bias_rad_s, 2)
    assert samples.accel_m_s2 is not None
    poses = find_poses(samples.time_s, samples.accel_m_s2, GRAVITY, TimeInterval(0.0, 10.0))
    assert len(poses.rests) == 31
    for k, rest in enumerate(poses.rests[1:]):
        begin_s = 14.0 + 5.0 * k
        assert begin_s - 0.6 <= rest.begin_s <= begin_s + 0.6
        assert rest.end_s <= begin_s + 3.6


@pytest.mark.parametrize("share", [0.0, 0.4])
def test_samples_without_an_acceleration_are_ignored(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray, share: float
) -> None:
    """A slower accelerometer, and a dropout of 6 s; before, no rest had a direction."""
    samples = handheld(samples_of, true_gain, true_bias_rad_s, 2)
    assert samples.accel_m_s2 is not None
    force = samples.accel_m_s2.copy()
    force[np.random.default_rng(3).random(len(force)) < share] = np.nan
    force[(samples.time_s > 40.0) & (samples.time_s < 46.0)] = np.nan
    poses = find_poses(samples.time_s, force, GRAVITY, TimeInterval(0.0, 10.0))
    whole = find_poses(samples.time_s, samples.accel_m_s2, GRAVITY, TimeInterval(0.0, 10.0))
    assert len(poses.rests) >= 29
    for first, rest, up in zip(poses.first_sample, poses.rests, poses.direction, strict=True):
        assert samples.time_s[first] == rest.begin_s
        assert np.linalg.norm(whole.direction - up, axis=1).min() < 0.01


@pytest.mark.long
def test_errors_are_what_the_covariance_says(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    scores = []
    for seed in range(8):
        fit = fit_gravity(handheld(samples_of, true_gain, true_bias_rad_s, seed), GRAVITY)
        assert fit.observability.rank == 12
        scores.append(((fit.gain - true_gain) / fit.gain_std).ravel())
        np.testing.assert_allclose(fit.bias_rad_s, true_bias_rad_s, atol=2e-4)
    every = np.concatenate(scores)
    assert 0.4 < np.mean(every**2) < 1.8
    assert np.abs(every).max() < 4.5


def with_bent_rests(make: Maker, samples: GyroSamples, seed: int) -> GyroSamples:
    """Return the samples with an error of the accelerometer that is constant in each pose."""
    assert samples.accel_m_s2 is not None
    rng = np.random.default_rng(seed)
    force = samples.accel_m_s2.copy()
    force[:1300] += rng.normal(0.0, 0.05, 3)
    for first in range(1300, len(force), 500):
        force[first : first + 500] += rng.normal(0.0, 0.05, 3)
    return make(samples.time_s, samples.rate_rad_s, force)


def test_moves_share_the_errors_of_the_accelerometer(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    """The rests between the moves and the nine unknowns are common to several moves.

    Before, the rms of these errors was 1.7 standard uncertainties.
    """
    samples = handheld(samples_of, true_gain, true_bias_rad_s, 2, 14, rate_noise_rad_s=1e-4)
    fits = [fit_gravity(with_bent_rests(samples_of, samples, seed), GRAVITY) for seed in range(20)]
    scores = np.array([(fit.gain - true_gain) / fit.gain_std for fit in fits])
    assert 0.6 < np.sqrt(np.mean(scores**2)) < 1.2
    assert np.abs(scores).max() < 4.0


def test_a_nominal_scale_a_quarter_off_is_found(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    gain = 0.75 * true_gain
    fit = fit_gravity(handheld(samples_of, gain, true_bias_rad_s, 11), GRAVITY)
    assert np.abs((fit.gain - gain) / fit.gain_std).max() < 4.5
    assert not fit.limited_reasons or all("time offset" in text for text in fit.limited_reasons)


def test_turns_about_two_axes_hide_the_third(
    samples_of: Maker, true_bias_rad_s: FloatArray
) -> None:
    """Two of the three columns are shown; what is not is null, whatever a solver prints."""
    samples = handheld(samples_of, np.eye(3), true_bias_rad_s, 3, axes=np.eye(3)[:2])
    fit = fit_gravity(samples, GRAVITY)
    assert np.isnan(fit.gain[:, 2]).all()
    assert np.isfinite(fit.gain[:, 0]).any()
    assert any("column z" in text for text in fit.observability.reasons)


def test_few_poses_no_accelerometer_and_gaps_are_refused(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    few = handheld(samples_of, true_gain, true_bias_rad_s, 4, moves=5)
    with pytest.raises(InputError, match="too few rests to calibrate the accelerometer"):
        fit_gravity(few, GRAVITY)
    with pytest.raises(InputError, match="no accelerometer"):
        fit_gravity(samples_of(few.time_s, few.rate_rad_s), GRAVITY)
    whole = handheld(samples_of, true_gain, true_bias_rad_s, 5, moves=12)
    whole.usable[::50] = False
    with pytest.raises(InputError, match="only 0 are usable"):
        fit_gravity(whole, GRAVITY)


def remapped(
    make: Maker,
    samples: GyroSamples,
    gyro_axes: FloatArray | None = None,
    accel_axes: FloatArray | None = None,
    rate_factor: float = 1.0,
    time_factor: float = 1.0,
) -> GyroSamples:
    """Return the samples as an import with a wrong column map gives them."""
    assert samples.accel_m_s2 is not None
    identity = np.eye(3)
    return make(
        samples.time_s * time_factor,
        rate_factor * samples.rate_rad_s @ (identity if gyro_axes is None else gyro_axes).T,
        samples.accel_m_s2 @ (identity if accel_axes is None else accel_axes).T,
    )


@pytest.mark.parametrize(
    ("accel_axes", "reason"),
    [
        pytest.param(
            np.diag([1.0, -1.0, 1.0]),
            "accelerometer are x, -y, z, or",
            id="reversed",
            marks=pytest.mark.long,
        ),
        pytest.param(
            np.eye(3)[[1, 0, 2]],
            "accelerometer are y, x, z, or",
            id="swapped",
            marks=pytest.mark.long,
        ),
        pytest.param(
            np.diag([-1.0, 1.0, 1.0])[[0, 2, 1]],
            "accelerometer are -x, z, y, or",
            id="reversed and swapped",
        ),
    ],
)
def test_wrong_axes_of_the_accelerometer_are_named(
    samples_of: Maker,
    true_gain: FloatArray,
    true_bias_rad_s: FloatArray,
    accel_axes: FloatArray,
    reason: str,
) -> None:
    samples = handheld(samples_of, true_gain, true_bias_rad_s, 6, moves=12)
    with pytest.raises(InputError, match="axes of gyro and accelerometer do not agree") as error:
        fit_gravity(remapped(samples_of, samples, accel_axes=accel_axes), GRAVITY)
    assert reason in str(error.value)


@pytest.mark.parametrize(
    ("factors", "reason"),
    [
        (
            {"rate_factor": np.degrees(1.0)},
            "as if its rates are in deg/s and the column map states rad/s",
        ),
        (
            {"rate_factor": np.radians(1.0)},
            "as if its rates are in rad/s and the column map states deg/s",
        ),
        pytest.param(
            {"time_factor": 1000.0},
            "as if the times are in ms and the column map states s",
            marks=pytest.mark.long,
        ),
        (
            {"gyro_axes": np.diag([1.0, 1.0, -1.0])},
            "they agree if the columns of the gyro are x, y",
        ),
    ],
    ids=["deg/s", "rad/s", "ms", "mirrored gyro"],
)
def test_wrong_units_and_a_mirrored_gyro_are_named(
    samples_of: Maker,
    true_gain: FloatArray,
    true_bias_rad_s: FloatArray,
    factors: dict[str, Any],
    reason: str,
) -> None:
    samples = handheld(samples_of, true_gain, true_bias_rad_s, 7, moves=12, rate_noise_rad_s=1e-3)
    with pytest.raises(InputError, match=reason):
        fit_gravity(remapped(samples_of, samples, **factors), GRAVITY)


def test_rotations_of_another_board_are_refused(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    samples = handheld(samples_of, true_gain, true_bias_rad_s, 8, moves=12)
    other = handheld(samples_of, true_gain, true_bias_rad_s, 9, moves=12)
    mixed = samples_of(samples.time_s, other.rate_rad_s, samples.accel_m_s2)
    with pytest.raises(InputError, match=r"does not agree with that of gravity.*each direction"):
        fit_gravity(mixed, GRAVITY)


def test_every_wrong_map_is_corrected_by_its_matrix() -> None:
    mismatches = list(list_mismatches())
    assert len(mismatches) == 4 * 48
    assert [m.text for m in mismatches].count("") == 1
    assert mismatches[0].text == ""
    by_text = {m.text: m.correction for m in mismatches}
    assert len(by_text) == len(mismatches)
    # The imported columns are y, z, x of the gyro.
    imported = np.eye(3)[[1, 2, 0]]
    (text,) = [t for t, c in by_text.items() if np.array_equal(c @ imported, np.eye(3))]
    assert text.endswith("accelerometer are y, z, x, or if the columns of the gyro are z, x, y")


def test_rounded_rests_share_the_error_of_their_rounding(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    """Before, the bias differed by 48 standard uncertainties from the true one."""
    step_rad_s = 0.009
    samples = handheld(samples_of, true_gain, true_bias_rad_s, seed=5, rate_noise_rad_s=1e-3)
    rounded = np.rint(samples.rate_rad_s / step_rad_s) * step_rad_s
    coarse = samples_of(samples.time_s, rounded, samples.accel_m_s2)
    fit = fit_gravity(replace(coarse, quantum_rad_s=step_rad_s), GRAVITY)
    std = np.array([fit.std[f"bias.{axis}"] for axis in "xyz"])
    assert np.all(np.abs(fit.bias_rad_s - true_bias_rad_s) < 2.0 * std)
    assert std == pytest.approx(step_rad_s / np.sqrt(12.0), rel=0.1)


def excess(fit: GyroFit) -> list[str]:
    """Return the reasons that the moves have too large residuals."""
    return [reason for reason in fit.limited_reasons if "Lost rows" in reason]


def without_rows(make: Maker, samples: GyroSamples, share: float, seed: int) -> GyroSamples:
    """Return the samples of a log that lost rows and has no column of times."""
    assert samples.accel_m_s2 is not None
    kept_rows = np.random.default_rng(seed).random(samples.time_s.size) > share
    return make(
        samples.time_s[: kept_rows.sum()],
        samples.rate_rad_s[kept_rows],
        samples.accel_m_s2[kept_rows],
    )


def test_lost_rows_without_times_limit_the_verdict(
    samples_of: Maker, true_gain: FloatArray, true_bias_rad_s: FloatArray
) -> None:
    """Before, the scale factors were 2 % too small, and only a remark had the residuals."""
    sound = handheld(samples_of, true_gain, true_bias_rad_s, 12, rate_noise_rad_s=1e-3)
    lossy = fit_gravity(without_rows(samples_of, sound, 0.02, 1), GRAVITY)
    assert np.trace(lossy.gain) == pytest.approx(0.98 * np.trace(true_gain), abs=0.02)
    (reason,) = excess(lossy)
    assert "a sample rate that changes" in reason
    fit = fit_gravity(sound, GRAVITY)
    assert not excess(fit)
    assert fit.gravity_moves is not None
    assert fit.gravity_moves.sigma_rad < 1.3 * fit.gravity_moves.predicted_sigma_rad
    assert np.all(np.abs(fit.gain - true_gain) < 4.0 * fit.gain_std)
    # The lost rows shift the gain by many standard uncertainties.
    assert np.abs((lossy.gain - true_gain) / lossy.gain_std).max() > 4.0


@pytest.mark.parametrize(
    ("sigma_deg", "moves", "rests", "is_excess"),
    [
        (0.19, 200, 200, False),
        (0.21, 200, 200, True),
        (0.24, 24, 25, False),
        (0.26, 24, 25, True),
        (0.9, 9, 10, False),
    ],
)
def test_few_rests_need_a_larger_excess(
    sigma_deg: float, moves: int, rests: int, is_excess: bool
) -> None:
    """The scatter of few rests does not predict the residuals well."""
    least_ratio = detectable_ratio(1.0, moves, rests)
    text = describe_excess(np.radians(sigma_deg), np.radians(0.1), least_ratio)
    assert bool(text) == is_excess
    assert f"deviation of {sigma_deg:.2g} deg" in text or not is_excess
