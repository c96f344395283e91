"""The emulated board: meaning of its counts, framing, faults."""

from dataclasses import replace

import numpy as np
import pytest

from gyrorig_daemon.emulator.board import EmulatedBoard
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import BoardFaults, BoardSettings, RigSettings
from gyrorig_daemon.emulator.physics.imu import ImuModel, ImuTruth
from gyrorig_daemon.emulator.rig_truth import sample_rig_truth
from gyrorig_protocol.board import (
    Ack,
    Batch,
    ColumnMap,
    FrameEvent,
    FrameFault,
    FrameParser,
    Hello,
    HelloRequest,
    Sample,
    SampleFlag,
    Set,
    Slow,
    TextLineParser,
    TimeReply,
    TimeRequest,
)

SECOND = 1_000_000_000
PLAIN = BoardSettings(name="B")


def board(settings: BoardSettings = PLAIN, seed: int = 1) -> tuple[EmulatedRig, EmulatedBoard]:
    rig = EmulatedRig(RigSettings(seed=seed, boards=(settings,)), 0)
    return rig, rig.boards[settings.name]


def frames(emulated: EmulatedBoard, seconds: float) -> list[object]:
    data = b"".join(d for _, d in emulated.take_output(round(seconds * SECOND)))
    return [e.frame if isinstance(e, FrameEvent) else e for e in FrameParser().feed(data, 0)]


def samples_of(emulated: EmulatedBoard, seconds: float) -> list[Sample]:
    return [f for f in frames(emulated, seconds) if isinstance(f, Sample)]


def test_samples_come_at_the_sensors_own_rate_with_its_own_stamps() -> None:
    rig, emulated = board()
    got = samples_of(emulated, 30.0)
    truth = rig.truth.boards["B"]
    assert len(got) == pytest.approx(30.0 * truth.imu.odr_hz, abs=2)
    assert [s.sequence for s in got] == list(range(len(got)))
    stamps = np.array([s.device_time for s in got], dtype=np.float64)
    steps = np.diff(stamps) % 2**32
    period_us = 1e6 / truth.imu.odr_hz * (1.0 + truth.clock.skew)
    assert steps.mean() == pytest.approx(period_us, rel=2e-6)
    assert all(s.flags == SampleFlag.STAMPED_AT_DATA_READY for s in got)


def test_counts_mean_gain_times_rate_plus_bias() -> None:
    # A constant pan rate: the mean of y is G (0, w sin t, w cos t) + bias.
    rig, emulated = board()
    assert rig.ptu is not None
    rig.ptu.receive(b"TS500 TP-600 ", 0)
    rig.ptu.receive(b"PS800 PP-3000 ", 3 * SECOND)
    rig.ptu.receive(b"PP3000 ", 8 * SECOND)
    imu = rig.truth.boards["B"].imu
    got = samples_of(emulated, 15.0)
    y = np.array([s.gyro for s in got]) * imu.gyro_scale_rad_s
    seconds = np.arange(len(got)) / imu.odr_hz
    mean = y[(seconds > 9.0) & (seconds < 14.0)].mean(axis=0)
    arcsec = np.pi / 648000.0
    w, t = 800 * 185.142857 * arcsec, -600 * 185.142857 * arcsec
    expected = imu.gain @ [0.0, w * np.sin(t), w * np.cos(t)]
    bias = emulated.mean_bias_rad_s(9 * SECOND, 14 * SECOND)
    # 0.03 dps/rtHz over 5 s is 0.0095 dps = 1.7e-4 rad/s.
    assert mean == pytest.approx(expected + bias, abs=6e-4)


@pytest.mark.long
def test_noise_at_rest_has_the_density_through_the_low_pass() -> None:
    rig, emulated = board()
    truth = rig.truth.boards["B"].imu
    y = np.array([s.gyro for s in samples_of(emulated, 300.0)]) * truth.gyro_scale_rad_s
    # Noise bandwidth of a 2nd-order Butterworth: pi / (2 sqrt 2) x its cut-off.
    expected = truth.noise_density_rad_s_rthz * np.sqrt(25.0 * np.pi / (2 * np.sqrt(2)))
    short = y[1:] - y[:-1]
    # Differences take the wander out; neighbours at 100 Hz are hardly correlated.
    lag = np.exp(-np.pi * np.sqrt(2) * 25.0 / truth.odr_hz)
    phase = np.pi * np.sqrt(2) * 25.0 / truth.odr_hz
    correlation = lag * (np.cos(phase) + np.sin(phase))
    sigma = short.std(axis=0) / np.sqrt(2.0 * (1.0 - correlation))
    quantum = truth.gyro_scale_rad_s / np.sqrt(12.0)
    assert sigma == pytest.approx(np.hypot(expected, quantum), rel=0.03)


def test_accelerometer_reads_gravity_in_the_sensor_frame() -> None:
    rig, emulated = board()
    truth = rig.truth.boards["B"].imu
    counts = np.array([s.accel for s in samples_of(emulated, 20.0)])
    expected = truth.mounting @ [0, 0, 9.80665] * truth.accel_gain + truth.accel_bias_m_s2
    assert counts.mean(axis=0) * truth.accel_scale_m_s2 == pytest.approx(expected, abs=0.01)


def still_imu(**changes: object) -> ImuTruth:
    """A sensor without noise and error, at 100 Hz."""
    truth = sample_rig_truth(RigSettings(boards=(PLAIN,))).boards["B"].imu
    quiet = replace(
        truth,
        odr_hz=100.0,
        gain=np.eye(3),
        bias_rad_s=np.zeros(3),
        noise_density_rad_s_rthz=np.zeros(3),
        bias_instability_rad_s=np.zeros(3),
        rate_random_walk=np.zeros(3),
        tau_s=0.0,
        gyro_scale_rad_s=5e-5,
    )
    return replace(quiet, **changes)  # type: ignore[arg-type]


def noiseless_path(truth: ImuTruth, interrupt_at: int) -> np.ndarray:
    """Angle about z from 3 s of samples around a move; the model may run ahead of it."""
    rig, _ = board()
    model = ImuModel(truth, rig.stage, 0.0, np.random.default_rng(0))
    total = []
    for k in range(40):
        block = model.next_block()
        if k == interrupt_at:
            rig.stage.pan.move(0.4, 200)
            block = model.recompute_if_moved() or block
        total.append(block.gyro[:, 2])
    return np.concatenate(total)


def test_a_command_inside_a_block_gives_what_knowing_it_before_gives() -> None:
    truth = still_imu()
    # 0.4 s lies in block 5 of 0.08 s; told before block 0 it is the same motion.
    early, late = noiseless_path(truth, 0), noiseless_path(truth, 5)
    assert (early == late).all()
    turned = late.sum() * truth.gyro_scale_rad_s / truth.odr_hz
    assert turned == pytest.approx(200 * 185.142857 * np.pi / 648000.0, rel=2e-4)


def test_tau_is_a_pure_delay() -> None:
    late = noiseless_path(still_imu(tau_s=0.03), 0)
    prompt = noiseless_path(still_imu(), 0)
    assert late[3:] == pytest.approx(prompt[:-3], abs=2)


def test_a_noise_floor_is_white_behind_the_low_pass_and_changes_nothing_else() -> None:
    rig, _ = board()
    noisy = still_imu(noise_density_rad_s_rthz=np.full(3, 5e-4), gyro_scale_rad_s=1e-7)
    floor = np.array([0.0, 1e-4, 2e-4])
    models = [
        ImuModel(truth, rig.stage, 0.0, np.random.default_rng(3))
        for truth in (noisy, replace(noisy, noise_floor_rad_s_rthz=floor))
    ]
    plain, with_floor = (
        np.concatenate([model.next_block().rate_rad_s for _ in range(500)]) for model in models
    )
    added = with_floor - plain
    assert not added[:, 0].any()
    count = len(added)
    std = floor[1:] * np.sqrt(noisy.odr_hz / 2.0)
    assert added[:, 1:].std(axis=0) == pytest.approx(std, rel=4.0 / np.sqrt(2.0 * count))
    neighbours = np.mean(added[1:, 1:] * added[:-1, 1:], axis=0) / std**2
    assert np.all(np.abs(neighbours) < 4.0 / np.sqrt(count))


def test_beyond_full_scale_is_marked_and_clipped() -> None:
    rig, _ = board()
    truth = still_imu(gyro_scale_rad_s=1e-5, gyro_limit_rad_s=0.4)
    model = ImuModel(truth, rig.stage, 0.0, np.random.default_rng(0))
    rig.stage.pan.move(0.0, 3000)
    block = [model.next_block() for _ in range(5)][-1]
    assert block.saturated.all()
    assert (block.gyro[:, 2] == 32767).all()


@pytest.mark.parametrize(("batch", "accel"), [(8, True), (8, False), (5, True)])
def test_batches_hold_the_same_samples(batch: int, accel: bool) -> None:
    plain = samples_of(board()[1], 5.0)
    got = frames(board(replace(PLAIN, batch=batch, accel=accel))[1], 5.0)
    batches = [f for f in got if isinstance(f, Batch)]
    assert [b.sequence for b in batches] == [batch * k for k in range(len(batches))]
    rows = [row for b in batches for row in b.gyro]
    same = min(len(rows), 8)  # noise is drawn a block at a time; the first block is shared
    assert rows[:same] == [s.gyro for s in plain[:same]]
    assert (batches[0].accel is not None) == accel


def test_text_lines() -> None:
    settings = replace(PLAIN, format="text", text_separator=" ")
    _, emulated = board(settings)
    data = b"".join(d for _, d in emulated.take_output(2 * SECOND))
    columns = ColumnMap(
        time=0, gyro=(1, 2, 3), accel=(4, 5, 6), temperature=7, time_unit="us", columns=8
    )
    got = [e.frame for e in TextLineParser(columns).feed(data, 0) if isinstance(e, FrameEvent)]
    plain = samples_of(board()[1], 2.0)
    assert len(got) > 190
    # The parser passes over the first line, which may be the rest of one.
    for line, sample in zip(got, plain[1:], strict=False):
        assert isinstance(line, Sample)
        assert (line.gyro, line.accel) == (sample.gyro, sample.accel)
        assert line.device_time == sample.device_time


def test_hello_comes_at_the_start_and_on_request() -> None:
    _, emulated = board()
    emulated.receive(HelloRequest().encode(), SECOND)
    hellos = [f for f in frames(emulated, 2.0) if isinstance(f, Hello)]
    assert len(hellos) == 2
    assert hellos[0] == hellos[1]
    assert hellos[0].sensors[0].rate_hz == 100
    assert hellos[0].uid


@pytest.mark.parametrize("odr_hz", [100.0, 800.0])
def test_the_longest_hello_fits(odr_hz: float) -> None:
    settings = replace(PLAIN, odr_hz=odr_hz, bandwidth_hz=12.5, full_scale_dps=2000.0)
    faults = BoardFaults(reset_at_s=tuple(1e-6 * k for k in range(1000)))
    got = frames(board(replace(settings, faults=faults))[1], 1.0)
    assert max(f.boot for f in got if isinstance(f, Hello)) == 1012


def test_clock_frames_come_at_random_phase_and_with_64_bits() -> None:
    rig, emulated = board()
    slow = [f for f in frames(emulated, 60.0) if isinstance(f, Slow)]
    assert len(slow) == pytest.approx(300, abs=25)
    ticks = np.array([f.device_time for f in slow])
    start = rig.truth.boards["B"].clock.start_ticks
    assert start < ticks[0]
    gaps = np.diff(ticks)
    assert gaps.min() >= 99_000
    assert gaps.max() <= 301_000
    assert gaps.std() > 40_000


def test_time_request_gets_both_stamps_and_its_nonce_back() -> None:
    _, emulated = board()
    emulated.receive(TimeRequest(77, 123_456).encode(), SECOND)
    reply = next(f for f in frames(emulated, 2.0) if isinstance(f, TimeReply))
    assert (reply.nonce, reply.host_stamp) == (77, 123_456)
    # 17 bytes at 460800 baud are 0.369 ms.
    arrived = emulated.clock.ticks(SECOND + 369_000)
    assert reply.device_receive == pytest.approx(arrived, abs=30)
    assert reply.device_send >= reply.device_receive + 190


def hello_config(got: list[object]) -> str:
    return next(f for f in got if isinstance(f, Hello)).config


def test_set_takes_what_the_sensor_can_do_and_says_so() -> None:
    _, emulated = board()
    emulated.receive(Set(rate_hz=400.0, bandwidth_hz=100.0, batch=4).encode(), SECOND)
    got = frames(emulated, 3.0)
    ack = next(f for f in got if isinstance(f, Ack))
    assert (ack.rate_hz, ack.bandwidth_hz, ack.batch) == (400, 110, 4)
    assert ack.config != hello_config(got)
    before = [f for f in got if isinstance(f, Sample)]
    after = [f for f in got if isinstance(f, Batch)]
    assert len(before) == pytest.approx(100, abs=16)
    assert 4 * len(after) == pytest.approx(800, abs=70)
    assert after[0].sequence == before[-1].sequence + 1
    assert all(f.flags & SampleFlag.CONFIGURATION_CHANGED for f in after)


def test_a_reset_starts_clock_sequence_and_boot_anew() -> None:
    _, emulated = board(replace(PLAIN, faults=BoardFaults(reset_at_s=(2.0,))))
    got = frames(emulated, 4.0)
    boots = [f.boot for f in got if isinstance(f, Hello)]
    assert boots == [12, 13]
    at = next(k for k, f in enumerate(got) if isinstance(f, Hello) and f.boot == 13)
    later = [f for f in got[at:] if isinstance(f, Sample)]
    assert later[0].device_time == pytest.approx(500_000, abs=20_000)
    assert later[0].sequence == pytest.approx(50, abs=4)
    assert [s.sequence for s in later] == list(
        range(later[0].sequence, later[0].sequence + len(later))
    )


def test_a_board_that_starts_anew_neither_hears_nor_answers() -> None:
    _, emulated = board(replace(PLAIN, slow_hz=50.0, faults=BoardFaults(reset_at_s=(2.0,))))
    before = len(frames(emulated, 1.9))
    assert before > 0
    # one question just before the reset, one in the silence, one cut by its end, one after it
    emulated.receive(TimeRequest(1, 0).encode(), 2 * SECOND - 300_000)
    for nonce, at_s in ((2, 2.2), (3, 2.49995), (4, 2.6)):
        emulated.receive(TimeRequest(nonce, 0).encode(), round(at_s * SECOND))
    sent = emulated.take_output(3 * SECOND)
    assert not [at for at, _ in sent if 2.001 * SECOND < at < 2.5 * SECOND]
    got = FrameParser().feed(b"".join(data for _, data in sent), 0)
    answers = [e.frame for e in got if isinstance(e, FrameEvent) and isinstance(e.frame, TimeReply)]
    assert [answer.nonce for answer in answers] == [4]
    assert answers[0].device_receive == pytest.approx(600_000, abs=2_000)


def sequences(faults: BoardFaults) -> tuple[list[int], int]:
    got = frames(board(replace(PLAIN, slow_hz=0.0, faults=faults))[1], 3.0)
    bad = sum(isinstance(f, FrameFault) for f in got)
    return [f.sequence for f in got if isinstance(f, Sample)], bad


def test_faults_of_the_link() -> None:
    clean, bad = sequences(BoardFaults())
    assert clean == list(range(len(clean)))
    assert bad == 0
    dropped, _ = sequences(BoardFaults(drop_frame_every=10))
    assert 9 not in dropped
    assert 19 not in dropped
    doubled, _ = sequences(BoardFaults(duplicate_frame_every=10))
    assert doubled.count(9) == 2
    swapped, _ = sequences(BoardFaults(swap_frames_every=6))
    assert swapped[4:6] == [5, 4]
    flipped, bad = sequences(BoardFaults(flip_bit_every=10))
    assert bad >= 20
    assert set(flipped) <= set(clean)
    noisy, bad = sequences(BoardFaults(garbage_every=10))
    assert bad >= 20
    assert noisy == clean
    assert sequences(BoardFaults(garbage=True))[0] == []
    assert sequences(BoardFaults(drop_frame_every=1))[0] == []
    assert board(replace(PLAIN, faults=BoardFaults(silent=True)))[1].next_output_ns() is None


def test_every_other_board_wraps_its_clock_within_two_minutes() -> None:
    wraps = 0
    for seed in range(200):
        clock = sample_rig_truth(RigSettings(seed=seed, boards=(PLAIN,))).boards["B"].clock
        wraps += 2**32 - clock.start_ticks < 120_000_000
    assert 80 <= wraps <= 130
