"""Samples from recordings whose faults are known, because the test made them."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import ImuStatus
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.writer import RecordingWriter
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.count_columns import CountColumn, PhysicalField, stored_column
from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.estimate.predicted_observability import predict_observability
from gyrorig_solver.reference import RestReference

START_NS = 1_790_000_000_000_000_000
N = 4000
Write = Callable[..., GyroSamples]


@pytest.fixture
def written(tmp_path: Path) -> Write:
    """Return `written(...)`: a recording of one board with changes, read back as samples."""

    def write(
        board: str = "B",
        asked: str = "B",
        meta: dict[str, str] | None = None,
        **changed: np.ndarray,
    ) -> GyroSamples:
        rng = np.random.default_rng(1)
        t = np.arange(N) / 100.0
        columns = {
            "device_time": ((t + 4290.0) * 1e6).astype(np.int64) % 2**32,
            "sequence": (65_000 + np.arange(N)) % 65_536,
            "status": np.zeros(N, np.int64),
            "temperature": np.zeros(N, np.int64),
            "gyro": rng.integers(-50, 50, (N, 3)),
            **changed,
        }
        host = START_NS + np.maximum.accumulate((t + rng.exponential(3e-4, N)) * 1e9).astype(
            np.int64
        )
        host = changed.get("host", host)[: len(columns["sequence"])]
        columns.pop("host", None)
        metadata = {
            "gyrorig": {"session": "s", "anchor_utc_ns": "1", "anchor_monotonic_raw_ns": "1"},
            f"gyrorig.board.{board}": {
                "uid": "u",
                "sensor": "X",
                "link": "serial",
                "gyro_scale_rad_s": "0.001",
                "tick_hz": "1000000",
                "counter_bits": "32",
                **(meta or {}),
            },
        }
        path = tmp_path / "r.mcap"
        with RecordingWriter(path, metadata, []) as writer:
            writer.write_imu_array(
                BoardId(board), host_time_ns=host, publish_time_ns=None, **columns
            )
        return load_samples(read_recording(path), asked)

    return write


def test_a_clean_recording(written: Write) -> None:
    samples = written()
    assert samples.number.tolist() == list(range(N))
    assert samples.clock.wraps == 1  # the ticks pass 2^32
    assert (samples.lost, samples.repeated, samples.late) == (0, 0, 0)
    assert samples.period_s == pytest.approx(0.01, rel=1e-6)
    # Ticks are whole microseconds.
    assert np.diff(samples.time_s) == pytest.approx(0.01, abs=2e-6)


def test_lost_samples_leave_gaps(written: Write) -> None:
    keep = np.r_[0:1000, 1007:N]
    t = np.arange(N)[keep] / 100.0
    samples = written(
        device_time=((t + 4290.0) * 1e6).astype(np.int64) % 2**32,
        sequence=(65_000 + np.arange(N)[keep]) % 65_536,
        status=np.zeros(keep.size, np.int64),
        temperature=np.zeros(keep.size, np.int64),
        gyro=np.zeros((keep.size, 3), np.int64),
        host=START_NS + (t * 1e9).astype(np.int64),
    )
    assert samples.lost == 7
    assert samples.number[1000] == 1007
    assert samples.number[-1] == N - 1


def test_swapped_and_repeated_samples_are_excluded(written: Write) -> None:
    sequence = (65_000 + np.arange(N)) % 65_536
    ticks = ((np.arange(N) / 100.0 + 4290.0) * 1e6).astype(np.int64) % 2**32
    for column in (sequence, ticks):
        column[[2000, 2001]] = column[[2001, 2000]]
        column[3000] = column[2999]
    samples = written(sequence=sequence, device_time=ticks)
    assert samples.late == 1
    assert samples.number.size == N - 2
    assert np.all(np.diff(samples.number) > 0)
    assert samples.lost == 1  # 3000 never came: 2999 came twice


def test_a_restart_begins_a_segment(written: Write) -> None:
    t = np.arange(N) / 100.0
    samples = written(
        device_time=np.where(t < 20.0, (t + 500.0) * 1e6, (t - 19.5) * 1e6).astype(np.int64),
        sequence=np.where(t < 20.0, np.arange(N), np.arange(N) - 2000),
    )
    assert samples.clock.restarts == 1
    assert samples.number[2000] == 0
    assert samples.lost == 0
    assert np.diff(samples.time_s) == pytest.approx(0.01, abs=2e-3)


def test_slices_end_at_gaps_and_restarts(written: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    keep = np.r_[0:1000, 1007:N]
    t = np.arange(N)[keep] / 100.0
    restarted = keep >= 3000
    samples = written(
        device_time=np.where(restarted, (t - 29.5) * 1e6, (t + 500.0) * 1e6).astype(np.int64),
        sequence=np.where(restarted, keep - 3000, keep),
        status=np.zeros(keep.size, np.int64),
        temperature=np.zeros(keep.size, np.int64),
        gyro=np.zeros((keep.size, 3), np.int64),
        host=START_NS + (t * 1e9).astype(np.int64),
    )
    restart = int(np.argmax(restarted))
    for piece in (1 << 16, 999, 10):
        monkeypatch.setattr("gyrorig_solver.data.samples.PIECE_SAMPLES", piece)
        assert samples.contiguous_slices(8) == [slice(0, restart), slice(restart, keep.size)]
        assert samples.contiguous_slices(7)[0] == slice(0, 1000)
    assert samples.period_s == pytest.approx(0.01, rel=1e-6)


def test_saturated_and_repeated_samples_are_not_usable(written: Write) -> None:
    status = np.zeros(N, np.int64)
    status[100], status[200] = 1 << 1, 1 << 3
    gyro = np.zeros((N, 3), np.int64)
    gyro[300, 1] = -32768
    samples = written(status=status, gyro=gyro)
    assert np.flatnonzero(~samples.usable).tolist() == [100, 200, 300]


def test_a_missing_board_is_an_error(written: Write) -> None:
    with pytest.raises(
        InputError, match=r"r\.mcap does not contain board .C.\. Choose one of its boards: B"
    ):
        written(asked="C")


@pytest.mark.parametrize("scale", ["", "nan", "-1", "a lot"])
def test_an_invalid_scale_is_rejected(written: Write, scale: str) -> None:
    with pytest.raises(InputError, match="gyro_scale_rad_s"):
        written(meta={"gyro_scale_rad_s": scale})


def test_only_samples_with_a_temperature_have_one(written: Write) -> None:
    status = np.zeros(N, np.int64)
    status[::10] = 1 << 10
    raw = np.full(N, 30, np.int64)
    samples = written(
        status=status,
        temperature=raw,
        meta={"temperature_scale_c": "0.5", "temperature_offset_c": "10"},
    )
    assert samples.temperature_degc is not None
    assert np.nanmax(samples.temperature_degc) == np.nanmin(samples.temperature_degc) == 25.0
    assert np.isnan(samples.temperature_degc).sum() == N - N // 10


def test_only_samples_with_an_acceleration_have_one(written: Write) -> None:
    """Before, the others had 0 m/s^2: a slower accelerometer had a mean of 5.86."""
    status = np.where(np.arange(N) % 5 < 3, int(ImuStatus.ACCEL_VALID), 0)
    accel = np.where(status[:, None] > 0, [0, 0, 981], 0)
    samples = written(status=status, accel=accel, meta={"accel_scale_m_s2": "0.01"})
    assert samples.accel_m_s2 is not None
    assert np.array_equal(np.isnan(samples.accel_m_s2).all(axis=1), status == 0)
    assert np.nanmean(samples.accel_m_s2[:, 2]) == pytest.approx(9.81)


def test_a_motion_that_is_nowhere_known_shows_nothing(written: Write) -> None:
    with pytest.raises(
        InputError, match="the motion of the pan-tilt unit for the time in which board B"
    ):
        predict_observability(written(), RestReference(()), {})


def test_rates_stay_counts_until_requested(written: Write) -> None:
    accel = np.random.default_rng(2).integers(-300, 300, (N, 3))
    status = np.full(N, 1 << 8)
    sequence = (65_000 + np.arange(N)) % 65_536
    sequence[3000] = sequence[2999]
    samples = written(
        status=status, accel=accel, sequence=sequence, meta={"accel_scale_m_s2": "0.01"}
    )
    assert samples.counts.dtype == np.int16
    assert samples.gyro.scale == samples.quantum_rad_s == 0.001
    assert samples.number.size == N - 1
    assert np.array_equal(samples.rate_rad_s, samples.counts * 0.001)
    rows = slice(2990, 3010)
    assert np.array_equal(samples.gyro.values(rows), samples.rate_rad_s[rows])
    assert samples.accel_m_s2 is not None
    assert np.array_equal(samples.accel_m_s2, np.delete(accel, 3000, axis=0) * 0.01)
    assert samples.temperature is None
    assert samples.temperature_degc is None


def test_arrivals_are_read_on_request(written: Write) -> None:
    host = START_NS + np.arange(N) * 10_000_000 + np.random.default_rng(3).integers(0, 10**6, N)
    samples = written(host=host)
    assert samples.host_s == pytest.approx((host - host[0]) * 1e-9, abs=1e-15)


def test_a_long_recording_gives_the_same_samples(
    written: Write, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    status = np.full(N, (1 << 8) | (1 << 10))
    status[::7] = 0
    meta = {
        "accel_scale_m_s2": "0.01",
        "temperature_scale_c": "0.5",
        "temperature_offset_c": "20",
    }
    accel = np.random.default_rng(2).integers(-300, 300, (N, 3))
    short = written(status=status, accel=accel, meta=meta)
    monkeypatch.setattr("gyrorig_protocol.recording.topic_collector.MAX_RECORD_BYTES", 0)
    (tmp_path / "r.mcap").unlink()
    long = written(status=status, accel=accel, meta=meta)
    for name in ("time_s", "host_s", "number", "segment", "counts", "usable", "rate_rad_s"):
        assert np.array_equal(getattr(long, name), getattr(short, name)), name
    for name in ("accel_m_s2", "temperature_degc"):
        assert np.array_equal(getattr(long, name), getattr(short, name), equal_nan=True), name
    assert short.temperature_degc is not None
    assert np.isnan(short.temperature_degc[0])
    assert short.temperature_degc[1] == 20.0


def test_values_and_columns_give_the_same_fields() -> None:
    class Owner:
        field: PhysicalField[FloatArray] = PhysicalField()

    counts = np.arange(12, dtype=np.int16).reshape(4, 3)
    given, column = Owner(), Owner()
    given.field = np.asarray(counts * 0.5, np.float64)
    column.field = CountColumn(lambda: counts, 0.5)
    assert np.array_equal(given.field, column.field)
    assert column.field is column.field  # worked out once
    stored, plain = stored_column(column, "field"), stored_column(given, "field")
    assert stored is not None
    assert stored.counts is counts
    assert plain is not None
    assert np.array_equal(plain.values(slice(1, 2)), counts[1:2] * 0.5)
