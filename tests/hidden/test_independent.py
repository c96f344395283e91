"""Test the independent simulator: repeatability, sealed answers, and right sizes."""

import ast
import hashlib
import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.fft import idct
from tests.hidden.independent import make
from tests.hidden.independent.causes import HIDEABLE, draw_hiding
from tests.hidden.independent.draws import (
    TIERS,
    HiddenCause,
    HiddenEffect,
    Session,
    compute_low_pass_noncentrality,
    draw_session,
)
from tests.hidden.independent.effects import EFFECTS
from tests.hidden.independent.low_passes import ASSUMED, MILD, STRONG
from tests.hidden.independent.parts import USB_FRAME_S, Link, draw_parts
from tests.hidden.independent.simulation import NO_CAUSES
from tests.hidden.independent.sizing import (
    compute_cause_difference,
    find_cause_size,
    find_effect_size,
)
from tests.hidden.independent.stream import simulate_recording
from tests.hidden.scoring.answers import open_answer, read_seal
from tests.hidden.scoring.stated import explain_recording, make_line
from tests.hidden.truth.detectable import compute_detectable
from tests.hidden.truth.outside import SHAPES

from gyrorig_daemon.emulator.injection import CAUSES

pytestmark = pytest.mark.long
PROGRAM = "survey-40"


@cache
def make_null_session(seed: int = 1) -> Session:
    """Return a session without hidden effects."""
    return draw_session(seed, "nulls", program=PROGRAM)


def make_session_with_cause(name: str, times: float) -> Session:
    """Return the same session with one cause."""
    session = make_null_session()
    hiding = draw_hiding(name, np.random.default_rng(3))
    sized = find_cause_size(session.visibility, hiding, times)
    assert sized is not None
    return replace(session, kind="one", causes=(HiddenCause(hiding, times, sized),))


def test_the_simulator_does_not_import_the_solver_or_the_physics_of_the_emulator() -> None:
    for file in (Path(__file__).parent / "independent").rglob("*.py"):
        modules = [
            node.module or ""
            for node in ast.walk(ast.parse(file.read_text()))
            if isinstance(node, ast.ImportFrom)
        ]
        assert not any(module.startswith("gyrorig_solver") for module in modules), file
        daemon = {module for module in modules if module.startswith("gyrorig_daemon")}
        assert daemon <= {"gyrorig_daemon.emulator.injection"}, file  # names and largest sizes


def test_the_solver_finds_the_truth_of_a_null_session(tmp_path: Path) -> None:
    case = tmp_path / "1"
    seal = make.make_case(case, make_null_session())
    line = make_line(1, "real", explain_recording(case / "recording.mcap"))
    assert line["causes"] == []
    true = open_answer(case, seal).calibration
    for name, value in true.items():
        estimate, std, _ = line["calibration"][name]
        assert abs(estimate - value) < 5.0 * std, name


def test_the_seal_is_that_of_the_answer_and_the_recording_does_not_contain_the_cause(
    tmp_path: Path,
) -> None:
    case = tmp_path / "1"
    session = make_session_with_cause("scale_cubic", 3.0)
    seal = make.make_case(case, session)
    data = (case / "answer.json").read_bytes()
    assert hashlib.sha256(data).hexdigest() == seal == read_seal(case)
    assert b"scale_cubic" not in (case / "recording.mcap").read_bytes()
    (cause,) = open_answer(case, seal).causes
    assert cause.times == pytest.approx(3.0, rel=0.03)
    assert json.loads(data)["unmodelled"]["low_pass"] in MILD


def test_the_log_likelihood_gain_is_the_stated_noncentrality(tmp_path: Path) -> None:
    session = make_session_with_cause("scale_cubic", 4.0)
    noncentrality = session.causes[0].sized.noncentrality
    make.make_case(tmp_path / "1", session)
    line = make_line(1, "real", explain_recording(tmp_path / "1" / "recording.mcap"))
    (named,) = line["causes"]
    assert named["set"] == ["scale_cubic"]
    # The gain is a noncentral chi-square of three degrees of freedom.
    spread = np.sqrt(2.0 * (3.0 + 2.0 * noncentrality))
    assert abs(named["statistic"] - (noncentrality + 3.0)) < 4.0 * spread + 0.1 * noncentrality


def test_the_noise_of_the_samples_is_the_noise_of_the_whitening() -> None:
    session = make_session_with_cause("motor_coupling", 3.0)
    made = simulate_recording(session.scene, session.program, session.hidden_causes)
    gyroscope = session.scene.parts.gyroscope
    clean = session.scene.simulate_rates(session.hidden_causes).sample_rates()
    noise = made.rig.stream.gyro * gyroscope.quantum_rad_s - clean
    white = session.visibility.whiten(noise)
    assert float(np.mean(white**2)) == pytest.approx(1.0, abs=0.05)
    effect = compute_cause_difference(session.visibility, *session.items[0])
    assert abs(float(effect @ white)) < 4.0 * np.linalg.norm(effect)


@pytest.mark.parametrize("tier", TIERS)
def test_a_seed_makes_the_same_bytes_twice(tier: str, tmp_path: Path) -> None:
    for name in ("first", "second"):
        make.make_case(tmp_path / name, draw_session(4, tier, program=PROGRAM))
    for name in ("answer.json", "sealed.txt", "recording.mcap"):
        first, second = ((tmp_path / folder / name).read_bytes() for folder in ("first", "second"))
        assert first == second, name


def test_an_existing_recording_does_not_change(tmp_path: Path) -> None:
    folder = tmp_path / "7"
    folder.mkdir()
    (folder / "recording.mcap").write_bytes(b"kept")
    make.main(["--out", str(tmp_path), "--first", "7", "--count", "1", "--tier", "nulls"])
    assert (folder / "recording.mcap").read_bytes() == b"kept"


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_effect_outside_the_catalogue_is_visible(name: str) -> None:
    sized = find_effect_size(make_null_session().visibility, EFFECTS[name], 3.0)
    assert sized is not None
    assert sized.noncentrality == pytest.approx(9.0 * compute_detectable(name), rel=0.1)


def test_effects_and_causes_have_different_names() -> None:
    assert len(EFFECTS) >= 8
    assert not EFFECTS.keys() & (SHAPES.keys() | CAUSES.keys())
    assert set(HIDEABLE) <= CAUSES.keys()
    assert len(HIDEABLE) > 30


def test_the_order_of_a_filter_is_not_visible_without_hidden_effects() -> None:
    least = compute_detectable("low_pass_lag")
    assert compute_low_pass_noncentrality(make_null_session().visibility) < 0.2 * least
    strong = draw_session(1, "nulls", program=PROGRAM, filters="strong")
    assert compute_low_pass_noncentrality(strong.visibility) > least


@pytest.mark.parametrize("kind", [*STRONG, ASSUMED.kind])
def test_a_filter_has_its_bandwidth_and_its_delay(kind: str) -> None:
    low_pass = STRONG.get(kind, ASSUMED)
    assert abs(low_pass.compute_response(np.array([25.0]), 25.0)[0]) ** 2 == pytest.approx(
        0.5, abs=1e-3
    )
    slow_hz = 1e-3
    phase = float(np.angle(low_pass.compute_response(np.array([slow_hz]), 25.0)[0]))
    assert -phase / (2.0 * np.pi * slow_hz) == pytest.approx(
        low_pass.compute_delay_s(25.0), rel=1e-4
    )


@pytest.mark.parametrize("kind", sorted(MILD))
def test_a_stage_adds_its_delay(kind: str) -> None:
    low_pass = replace(MILD[kind], stage_s=2e-3)
    slow_hz = 1e-3
    phase = float(np.angle(low_pass.compute_response(np.array([slow_hz]), 25.0)[0]))
    assert -phase / (2.0 * np.pi * slow_hz) == pytest.approx(
        low_pass.compute_delay_s(25.0), rel=1e-4
    )


def test_samples_wait_for_the_frame_of_usb() -> None:
    ready_s = np.sort(np.random.default_rng(1).uniform(0.0, 10.0, size=2000))
    late_s = (
        Link(1e-3, 0.0, USB_FRAME_S).compute_arrival_s(ready_s, np.random.default_rng(2)) - ready_s
    )
    assert late_s.min() == pytest.approx(1e-3, abs=2e-5)
    assert late_s.max() == pytest.approx(2e-3, abs=2e-5)


def test_the_sample_rate_follows_the_temperature() -> None:
    parts = replace(draw_parts(5), odr_per_k=1e-3)
    step_s = np.diff(parts.compute_sample_times_s((0.0, 60.0)))
    warming = parts.gyroscope.warming
    die = warming.die_degc(np.array([0.0, 59.0]), 60.0)
    expected = 1.0 / (1.0 + 1e-3 * (die[1] - die[0]))
    assert step_s[-60] / step_s[0] == pytest.approx(expected, rel=2e-4)
    assert make_null_session().scene.simulate_rates(NO_CAUSES).sample_s.size > 4000


def test_the_likelihood_gain_of_a_scatter_is_its_stated_noncentrality() -> None:
    session, entry = make_null_session(), EFFECTS["rate_noise"]
    visibility = session.visibility
    sized = find_effect_size(visibility, entry, 4.0)
    assert sized is not None
    session = replace(session, kind="outside", effect=HiddenEffect(entry, 4.0, sized))
    made = simulate_recording(session.scene, session.program, NO_CAUSES, session.hidden_effect)
    gyroscope = session.scene.parts.gyroscope
    noise = made.rig.stream.gyro * gyroscope.quantum_rad_s - visibility.plain.sample_rates()
    coefficients = visibility.whiten(noise).reshape(-1, 3)
    white = idct(np.vstack([np.zeros(3), coefficients]), axis=0, norm="ortho")
    motion = visibility.motion
    amplitude = session.hidden_effect.noise_amplitude(motion, session.scene.span_s)
    power = np.interp(visibility.plain.sample_s, motion.middle_s, amplitude) ** 2
    gains = []
    for share in np.linspace(0.1, 1.5, 15):
        profile = 1.0 + share * (power - 1.0)
        levels = np.log(np.mean(white**2, axis=0) / np.mean(white**2 / profile[:, None], axis=0))
        gains.append(float(len(white) * np.sum(levels - np.mean(np.log(profile)))))
    assert max(gains) == pytest.approx(sized.noncentrality, rel=0.3)
