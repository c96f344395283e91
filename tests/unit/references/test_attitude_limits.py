"""Reference attitudes at the limits of the fit: rests, times that do not agree, short, slow."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.discover.attitude.attitude_space import AttitudeRecording, fit_attitude_space
from gyrorig_solver.estimate import fit_attitude
from gyrorig_solver.model import RecordingContext
from gyrorig_solver.reference import AttitudeReference, read_attitude

Maker = Callable[..., GyroSamples]
FAR = 4.5  # standard deviations


@pytest.fixture
def record(
    tumble: Callable[[int], object], samples_of: Maker, true_gain: FloatArray
) -> Callable[..., tuple[GyroSamples, AttitudeReference]]:
    """Return a function that makes the samples and attitudes of a moving board."""

    def make(
        span_s: float = 40.0, reference_hz: float = 100.0, shift_s: float = 0.0, seed: int = 1
    ) -> tuple[GyroSamples, AttitudeReference]:
        motion, rng = tumble(seed), np.random.default_rng(seed)
        time_s = np.arange(int(span_s * 200.0)) / 200.0
        rate = motion.rate_rad_s(time_s) @ true_gain.T  # type: ignore[attr-defined]
        at_s = np.arange(0.1, span_s - 0.1, 1.0 / reference_hz)
        noise = Rotation.from_rotvec(rng.normal(size=(at_s.size, 3)) * 3e-4)
        q = (motion.attitude(at_s) * noise).as_quat()  # type: ignore[attr-defined]
        samples = samples_of(time_s, rate + rng.normal(size=rate.shape) * 5e-4)
        return samples, read_attitude(at_s - shift_s, q, np.full(at_s.size, np.nan))

    return make


def rest_of(samples_of: Maker, seed: int) -> tuple[GyroSamples, AttitudeReference]:
    """Make the samples and attitudes of a board at rest."""
    rng = np.random.default_rng(100 + seed)
    time_s, at_s = np.arange(12000) / 200.0, np.arange(6000) / 100.0
    rate = np.array([0.01, -0.02, 0.005]) + 5e-4 * rng.normal(size=(time_s.size, 3))
    q = Rotation.from_rotvec(3e-4 * rng.normal(size=(at_s.size, 3))).as_quat()
    return samples_of(time_s, rate), read_attitude(at_s, q, np.full(at_s.size, np.nan))


@pytest.mark.long
def test_a_board_at_rest_shows_no_time_offset_and_no_drift(samples_of: Maker) -> None:
    """Before, the slope of the gyro's noise counted as motion: -285.0 +- 23.7 ms."""
    for seed in range(8):
        fit = fit_attitude([rest_of(samples_of, seed)])
        assert np.isnan(fit.time_offset_s)
        assert not fit.warnings


@pytest.mark.long
@pytest.mark.parametrize("is_rest_last", [False, True])
def test_a_rest_does_not_hide_the_time_offset(
    record: Callable[..., tuple[GyroSamples, AttitudeReference]],
    samples_of: Maker,
    is_rest_last: bool,
) -> None:
    """Before, the calibration stated the offset of the last recording."""
    moving, resting = record(shift_s=0.02), rest_of(samples_of, seed=3)
    recordings = [moving, resting] if is_rest_last else [resting, moving]
    fit = fit_attitude(recordings)
    assert abs(fit.time_offset_s - 0.02) < FAR * fit.std["time_offset"]
    names, context = ("first", "second"), RecordingContext(begin_s=0.0, end_s=40.0)
    space = fit_attitude_space(
        [
            AttitudeRecording(name, *pair, replace(context, recording_index=k))
            for k, (name, pair) in enumerate(zip(names, recordings, strict=True))
        ]
    )
    assert space.offset_recording == (0 if is_rest_last else 1)
    assert space.summarize().time_offset_s == pytest.approx(fit.time_offset_s, rel=1e-6)


@pytest.mark.parametrize("shift_s", [1.5, -3.0])
def test_a_large_shift_of_the_times_is_refused_with_its_size(
    record: Callable[..., tuple[GyroSamples, AttitudeReference]], shift_s: float
) -> None:
    with pytest.raises(InputError, match=rf"Add {shift_s:.2f} s to the times of the attitudes"):
        fit_attitude([record(shift_s=shift_s)])


def test_a_shift_at_the_limit_is_refused_and_a_smaller_one_is_fitted(
    record: Callable[..., tuple[GyroSamples, AttitudeReference]],
) -> None:
    fit = fit_attitude([record(shift_s=0.27)])
    assert abs(fit.time_offset_s - 0.27) < FAR * fit.std["time_offset"]
    with pytest.raises(InputError, match="times of the gyroscope"):
        fit_attitude([record(shift_s=0.31)])


@pytest.mark.parametrize("reference_hz", [5.0, 9.99])
def test_slow_attitudes_are_searched_for_causes(
    record: Callable[..., tuple[GyroSamples, AttitudeReference]],
    true_gain: FloatArray,
    reference_hz: float,
) -> None:
    """Before, references below 10 Hz ended with a fault in the program."""
    samples, reference = record(reference_hz=reference_hz)
    context = RecordingContext(begin_s=0.0, end_s=40.0)
    space = fit_attitude_space([AttitudeRecording("slow", samples, reference, context)])
    fit = space.summarize()
    assert np.isfinite(fit.gain).any()  # at 5 Hz, the turns between two attitudes are large
    assert np.nanmax(np.abs((fit.gain - true_gain) / fit.gain_std)) < FAR


@pytest.mark.parametrize("span_s", [1.5, 3.0, 4.0])
def test_short_recordings_are_refused(
    record: Callable[..., tuple[GyroSamples, AttitudeReference]], span_s: float
) -> None:
    with pytest.raises(InputError, match="too short for a fit"):
        fit_attitude([record(span_s=span_s)])


def test_gaps_everywhere_are_the_stated_reason(
    record: Callable[..., tuple[GyroSamples, AttitudeReference]],
) -> None:
    samples, reference = record()
    q = reference.orientation_xyzw.copy()
    q[np.arange(len(q)) % 60 >= 40] = np.nan
    gaps = read_attitude(reference.time_s, q, np.full(len(q), np.nan))
    with pytest.raises(InputError, match=r"overlap for \d+\.\d s, but have gaps"):
        fit_attitude([(samples, gaps)])
