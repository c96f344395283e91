"""Noise-free rates with and without injected causes, and their detectability."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy import fft
from tests.support.noncentrality import (
    Visibility,
    coefficient_variances,
    cosine_coefficients,
    detectable_noncentrality,
    visibility,
)

from gyrorig_daemon.cli import run
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import (
    BoardSettings,
    PtuFaults,
    PtuSettings,
    RigSettings,
)
from gyrorig_daemon.emulator.injection import parse_injection
from gyrorig_daemon.emulator.noise_free_rates import (
    NoiseFreeRates,
    compare_noise_free,
    move_starts_s,
)
from gyrorig_daemon.emulator.physics.imu import ImuModel
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_protocol.board import FrameEvent, FrameParser, Sample

UNIT = PtuSettings(base_speed_steps_s=58, acceleration_steps_s2=3900, speed_steps_s=1500)
COMMANDS = [(1.0, b"PP2000 "), (3.5, b"TP-500 "), (5.0, b"PP-1500 "), (6.2, b"H "),
            (7.0, b"TP400 "), (8.5, b"PP1200 "), (11.0, b"TP-600 "),
            (12.5, b"PP0 TP0 ")]  # fmt: skip
END_S = 16.0


def session(rig_settings: RigSettings) -> tuple[EmulatedRig, np.ndarray]:
    """A rig after its session, and the samples' numbers and words, (n, 4)."""
    rig = EmulatedRig(replace(rig_settings, session_s=(0.0, END_S)), 0)
    hub, data = VirtualHub(rig), b""
    for at_s, command in [*COMMANDS, (END_S, b"")]:
        while (chunk := hub.read(round(at_s * 1e9))) is not None:
            data += chunk.data if chunk.port != "ptu" else b""
        hub.write("ptu", command)
    frames = [e.frame for e in FrameParser().feed(data, 0) if isinstance(e, FrameEvent)]
    samples = [f for f in frames if isinstance(f, Sample)]
    return rig, np.array([(f.sequence, *f.gyro) for f in samples], dtype=np.float64)


def hiding(*hide: str, unit: PtuSettings = UNIT, noise_free: bool = False) -> RigSettings:
    orders = tuple(parse_injection(text) for text in hide)
    return RigSettings(seed=2, ptu=unit, injections=orders, noise_free=noise_free)


@pytest.mark.parametrize(
    "hide",
    [(), ("acceleration_error:0.02", "backlash:1e-3", "clock_step:0.01"), ("s_curve", "ringing")],
)
def test_the_twin_shows_what_the_rig_sends(hide: tuple[str, ...]) -> None:
    unit = replace(UNIT, faults=PtuFaults(lose_steps_at_s=5.3, lost_steps=4))
    rig, words = session(hiding(*hide, unit=unit, noise_free=True))
    rates = compare_noise_free(rig, round(END_S * 1e9))["GY80-1"]
    scale = rig.truth.boards["GY80-1"].imu.gyro_scale_rad_s
    shown = rates.hidden_rad_s[words[:, 0].astype(int)]
    # a block may have been sent in part before a command changed the rest of it
    assert np.abs(shown / scale - words[:, 1:]).max() <= 0.5 + 1e-6
    assert (rates.plain_rad_s == rates.hidden_rad_s).all() == (not hide)


def test_the_twins_obey_the_same_orders_whatever_delays_them() -> None:
    rig, _ = session(hiding("s_curve:0.1", "acceleration_error:0.05"))
    rates = compare_noise_free(rig, round(END_S * 1e9))["GY80-1"]
    bare, _ = session(hiding())
    plain = compare_noise_free(bare, round(END_S * 1e9))["GY80-1"]
    assert np.abs(rates.hidden_rad_s - rates.plain_rad_s).max() > 0.05
    assert rates.plain_rad_s == pytest.approx(plain.plain_rad_s, abs=1e-12)


def test_the_cosine_transform_is_the_one_of_others() -> None:
    rows = np.random.default_rng(1).standard_normal((501, 3))
    expected = fft.dct(rows, axis=0, norm="ortho")
    assert cosine_coefficients(rows) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("odr_hz", "bandwidth_hz"), [(100.0, 25.0), (400.0, 50.0)])
def test_noise_is_white_after_whitening(odr_hz: float, bandwidth_hz: float) -> None:
    board = BoardSettings(odr_hz=odr_hz, bandwidth_hz=bandwidth_hz)
    rig = EmulatedRig(RigSettings(seed=4, ptu=UNIT, boards=(board,)), 0)
    document = rig.truth_document()["boards"]["GY80-1"]
    imu = rig.truth.boards["GY80-1"].imu
    powers = []
    for seed in range(4):
        model = ImuModel(imu, rig.stage, 0.0, np.random.default_rng(seed))
        model.next_block()  # the low-pass begins empty
        counts = np.vstack([model.next_block().gyro for _ in range(400)])
        words: np.ndarray = counts.astype(np.float64) * imu.gyro_scale_rad_s
        variances = coefficient_variances(document, len(words))
        powers.append(cosine_coefficients(words)[1:] ** 2 / variances)
    power = np.mean(powers, axis=(0, 2))
    count = len(power)
    for low, high in ((0.002, 0.02), (0.02, 0.2), (0.2, 0.5), (0.5, 1.0)):
        band = power[int(low * count) : int(high * count)]
        sigma = np.sqrt(2.0 / (12 * len(band)))
        assert band.mean() == pytest.approx(1.0, abs=4 * sigma + 0.03)


@cache
def seen(*hide: str) -> Visibility:
    rig, _ = session(hiding(*hide))
    rates = compare_noise_free(rig, round(END_S * 1e9))["GY80-1"]
    document = rig.truth_document()["boards"]["GY80-1"]
    return visibility(rates, document, move_starts_s(rig), (0.5, END_S))


def test_visibility_goes_with_the_square_of_the_size() -> None:
    small, large = seen("backlash@pan:2e-4"), seen("worm_error@pan:1e-4")
    assert small.noncentrality > 10.0
    assert large.noncentrality > 10.0
    twice = seen("worm_error@pan:2e-4")
    assert twice.noncentrality == pytest.approx(4 * large.noncentrality, rel=1e-3)
    assert twice.absorbed == pytest.approx(large.absorbed, abs=1e-3)


def test_what_a_calibration_absorbs_is_not_visible() -> None:
    for cause in ("clock_offset:0.02", "step_resolution@pan:1e-3", "wrong_full_scale:2"):
        visible = seen(cause)
        assert visible.absorbed > 0.99999
    assert seen("motor_coupling:1e-3").absorbed < 0.8
    assert seen() == Visibility(0.0, 0.0)


def test_white_noise_alone_has_the_textbook_value() -> None:
    # A sine far from the edges in white noise of known density: A^2 T / density^2.
    rig = EmulatedRig(hiding(), 0)
    document = rig.truth_document()["boards"]["GY80-1"] | {
        "bias_instability_rad_s": [0.0] * 3, "rate_random_walk_rad_s_rts": [0.0] * 3,
        "gyro_scale_rad_s": 0.0, "odr_hz": 100.0,
    }  # fmt: skip
    time_s = np.arange(1, 10001) / 100.0
    plain = np.tile(document["bias_rad_s"], (10000, 1))
    wave = np.outer(np.sin(2 * np.pi * 2.0 * time_s), [1e-3, 0.0, 0.0])
    still = np.zeros_like(plain)
    rates = NoiseFreeRates(np.arange(10000), time_s, plain + wave, None, plain, plain, still)
    report = visibility(rates, document, [], (0.0, 100.0))
    density = document["noise_density_rad_s_rthz"][0]
    folded = 1.0 + 2 * 0.25**4 + 2 * 0.125**4  # what the 25 Hz low-pass leaves at 100, 200 Hz
    assert report.noncentrality == pytest.approx(1e-4 / (density**2 * folded), rel=1e-3)


def test_the_minimal_detectable_is_baardas() -> None:
    # alpha 0.1 %, power 80 %: 17.07 (Baarda 1968)
    assert detectable_noncentrality(0.001, 1, 0.8) == pytest.approx(17.07, abs=0.01)
    assert detectable_noncentrality() == pytest.approx(20.0, abs=0.1)


def test_rates_come_beside_the_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program = tmp_path / "p.yaml"
    program.write_text(
        "schema: gyrorig/program/1\nname: p\nsteps:\n  - rest: {seconds: 1.0}\n"
        "  - move: {pan_deg: 30.0, speed_deg_s: 40.0}\n"
    )
    rig = Path(__file__).resolve().parents[3] / "config" / "rig.yaml"
    arguments = ["record", "--config", str(rig), "--program", str(program), "--out", str(tmp_path),
                 "--rates", str(tmp_path / "rates.npz"), "--hide", "bias_ramp@x:1e-4"]  # fmt: skip
    assert run([*arguments, "--simulated-time"]) == 0
    with np.load(tmp_path / "rates.npz") as arrays:
        added = arrays["GY80-1.hidden_rad_s"] - arrays["GY80-1.plain_rad_s"]
        assert added[:, 0] == pytest.approx(1e-4 * arrays["GY80-1.time_s"], abs=1e-12)
        assert len(arrays["pan_s"]) == 1
        both = dict(arrays)
    assert run([*arguments, "--simulated-time", "--rates-of-session"]) == 0
    with np.load(tmp_path / "rates.npz") as arrays:
        names = {f"GY80-1.{name}" for name in ("number", "time_s", "hidden_rad_s", "between_rad_s")}
        assert set(arrays.files) == names | {"pan_s", "tilt_s"}
        assert all(np.array_equal(arrays[name], both[name]) for name in arrays.files)
    assert run(arguments) == 2
    assert "--rates works only with the option --simulated-time" in capsys.readouterr().err
