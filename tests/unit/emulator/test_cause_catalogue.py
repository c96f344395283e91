"""All causes: names, sizes, components, seeds, and what they do not change."""

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import BoardSettings, PtuSettings, RigSettings
from gyrorig_daemon.emulator.injection import CAUSES, parse_injection, sample_injected_causes
from gyrorig_daemon.emulator.physics.imu import BLOCK_S
from gyrorig_daemon.emulator.rig_truth import sample_rig_truth
from gyrorig_daemon.emulator.truth_commitment import TruthCommitment, truth_digest
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_protocol.board import FrameEvent, FrameParser, Sample
from gyrorig_protocol.errors import UsageError

UNIT = PtuSettings(base_speed_steps_s=58, acceleration_steps_s2=3900, speed_steps_s=1500)
MOVES = (("pan", 1.0, 2600), ("tilt", 2.0, -700), ("pan", 4.5, -500), ("tilt", 5.5, 300),
         ("pan", 8.0, 900), ("tilt", 8.2, -300), ("pan", 9.5, -2000))  # fmt: skip
END_S = 12.0
IN_WORDS = ("repeated_samples", "corrupt_samples", "axis_swap", "sign_flip")
LATER_CAUSES = {"clock_sawtooth": "clock"}  # the contract allows new ids
ABSENT = {"wrong_full_scale": 1.0, "saturation": 100.0}  # sizes at which there is nothing


def settings(*hide: str, seed: int = 3, noise_free: bool = False) -> RigSettings:
    orders = tuple(parse_injection(text) for text in hide)
    return RigSettings(
        seed=seed, ptu=UNIT, injections=orders, session_s=(0.0, END_S), noise_free=noise_free
    )


def words_of(rig_settings: RigSettings) -> np.ndarray:
    """The gyro's words and rates of the first board, (n, 6), by the physics alone."""
    rig = EmulatedRig(rig_settings, 0)
    for name, time_s, target in MOVES:
        axis = rig.stage.pan if name == "pan" else rig.stage.tilt
        axis.move(time_s, target)
    imu = rig.boards[rig_settings.boards[0].name]._imu
    blocks = [imu.next_block() for _ in range(round(END_S / BLOCK_S))]
    return np.hstack(
        [np.vstack([b.gyro for b in blocks]), np.vstack([b.rate_rad_s for b in blocks])]
    )


@cache
def plain() -> np.ndarray:
    return words_of(settings(noise_free=True))


def energy(*hide: str) -> float:
    """The sum of squares of what the causes change without noise."""
    rates = words_of(settings(*hide, noise_free=True)) - plain()
    words = rates[:, :3] if any(h.startswith(IN_WORDS) for h in hide) else rates[:, 3:]
    return float((words**2).sum())


def test_the_catalogue_of_the_contract_is_complete(contracts: Path) -> None:
    text = (contracts / "results.md").read_text()
    table = text.split("## Catalogue of causes")[1].split("An id says")[0]
    catalogue = {
        name: part
        for part, names in re.findall(r"^\| (\w+) \| ([\w, ]+) \|$", table, flags=re.MULTILINE)
        for name in names.split(", ")
        if part != "part"
    }
    assert len(catalogue) == 41
    assert {name: cause.part for name, cause in CAUSES.items()} == catalogue | LATER_CAUSES


@pytest.mark.parametrize("name", CAUSES)
def test_sizes_are_ordered_and_drawn_within_their_range(name: str) -> None:
    cause = CAUSES[name]
    assert (
        cause.min_size <= cause.sampled_min <= cause.typical <= cause.sampled_max <= cause.max_size
    )
    for seed in range(20):
        (hidden,) = sample_injected_causes(settings(name, seed=seed))
        size = hidden.size.number
        assert cause.sampled_min <= abs(size) <= cause.sampled_max * (1 + 1e-12)
        assert size > 0 or cause.is_signed
        assert json.loads(json.dumps(hidden.to_document())) == hidden.to_document()
    assert sample_injected_causes(settings(name)) == sample_injected_causes(settings(name))


@pytest.mark.parametrize("name", [n for n in CAUSES if n != "lost_samples"])
def test_a_cause_of_no_size_changes_nothing(name: str) -> None:
    at_none = words_of(settings(f"{name}:{ABSENT.get(name, 0.0)!r}", noise_free=True))
    assert (at_none[:, :3] == plain()[:, :3]).all()
    assert at_none == pytest.approx(plain(), abs=1e-12)


@pytest.mark.parametrize("name", [n for n in CAUSES if n != "lost_samples"])
def test_a_larger_size_has_more_energy(name: str) -> None:
    cause = CAUSES[name]
    if name in ("axis_swap", "sign_flip"):
        assert energy(name) > 0.0
        return
    sizes = [cause.sampled_min, cause.typical, cause.sampled_max]
    if name == "saturation":
        sizes = [1.3, 1.0, 0.7]  # a lower limit cuts more
    elif name == "corrupt_samples":
        sizes = [0.01, 0.03, 0.1]  # 12 s have too few samples for less
    elif name in ("wrong_full_scale", "earth_rotation"):
        sizes = [s * cause.typical for s in (1.0, 2.0, 4.0)]
    energies = [energy(f"{name}:{size!r}") for size in sizes]
    assert 0.0 < energies[0] < energies[1] < energies[2]


def test_a_size_given_changes_neither_place_nor_phase() -> None:
    (drawn,) = sample_injected_causes(settings("worm_error"))
    (given,) = sample_injected_causes(settings("worm_error:1e-4"))
    assert (drawn.component, drawn.parameters["phase"]) == (
        given.component,
        given.parameters["phase"],
    )
    assert given.size.number == 1e-4


def test_the_sign_of_the_size_is_the_sign_of_the_effect() -> None:
    up, down = (
        words_of(settings(f"scale_quadratic:{s}", noise_free=True))[:, 3:] - plain()[:, 3:]
        for s in ("1e-3", "-1e-3")
    )
    assert up == pytest.approx(-down, abs=1e-12)


def test_effects_of_several_causes_add_up() -> None:
    both = words_of(settings("backlash@pan:1e-3", "bias_step:1e-3", noise_free=True))
    single = words_of(settings("backlash@pan:1e-3", noise_free=True))
    other = words_of(settings("bias_step:1e-3", noise_free=True))
    total = (single + other - 2 * plain())[:, 3:]
    assert (both - plain())[:, 3:] == pytest.approx(total, abs=1e-12)


def test_every_cause_at_once() -> None:
    rig_settings = settings(*CAUSES)
    assert np.isfinite(words_of(rig_settings)).all()
    assert {cause.cause for cause in sample_rig_truth(rig_settings).injected} == set(CAUSES)


def test_hiding_leaves_the_rest_of_the_truth_and_the_noise_alone() -> None:
    bare, hiding = sample_rig_truth(settings()), sample_rig_truth(settings("backlash", "warm_up"))
    document = hiding.to_document()
    assert document.pop("hidden")["causes"][0]["cause"] == "backlash"
    assert document == bare.to_document()
    noisy = words_of(settings("bias_step:1e-3"))[:, 3:] - words_of(settings())[:, 3:]
    quiet = words_of(settings("bias_step:1e-3", noise_free=True))[:, 3:] - plain()[:, 3:]
    assert noisy == pytest.approx(quiet, abs=1e-12)


def test_what_is_a_value_of_the_truth_stands_in_it() -> None:
    bare = sample_rig_truth(settings()).to_document()
    hiding = sample_rig_truth(
        settings(
            "clock_offset:0.004", "low_pass_lag:-0.2", "axis_nonorthogonality:0.01",
            "step_resolution@tilt:0.003",
        )
    ).to_document()  # fmt: skip
    board, before = hiding["boards"]["GY80-1"], bare["boards"]["GY80-1"]
    assert board["tau_s"] == pytest.approx(before["tau_s"] + 0.004)
    assert board["low_pass"]["cutoff_hz"] == pytest.approx(20.0)
    assert hiding["tilt_axis_error_rad"] == 0.01
    assert (hiding["pan_scale_error"], hiding["tilt_scale_error"]) == (0.0, 0.003)


def test_places_are_boards_axes_or_both() -> None:
    boards = tuple(BoardSettings(name=name) for name in ("A", "B"))
    rig = replace(settings(), boards=boards)

    def where(text: str) -> tuple[str | None, str]:
        (hidden,) = sample_injected_causes(replace(rig, injections=(parse_injection(text),)))
        return hidden.board, hidden.component

    assert where("bias_step@B") == ("B", "x,y,z")
    assert where("bias_step@B.y") == ("B", "y")
    assert where("bias_step@z")[1] == "z"
    assert where("backlash@tilt") == (None, "tilt")
    drawn = {where_of.board for seed in range(20) for where_of in sample_injected_causes(
        replace(rig, seed=seed, injections=(parse_injection("warm_up"),)))}  # fmt: skip
    assert drawn == {"A", "B"}
    both = sample_injected_causes(
        replace(rig, injections=(parse_injection("warm_up@A"), parse_injection("warm_up@B")))
    )
    assert [h.board for h in both] == ["A", "B"]


def test_only_the_named_board_has_it() -> None:
    boards = tuple(BoardSettings(name=name) for name in ("A", "B"))
    rig_settings = replace(settings(noise_free=True), boards=boards)
    hiding = replace(rig_settings, injections=(parse_injection("bias_step@B:1e-3"),))
    assert (words_of(hiding) == words_of(rig_settings)).all()
    other = replace(rig_settings, injections=(parse_injection("bias_step@A:1e-3"),))
    assert (words_of(other) != words_of(rig_settings)).any()


def test_random_draws_causes_that_differ_and_depend_on_the_seed() -> None:
    drawn = [sample_injected_causes(settings("random", "random", seed=seed)) for seed in range(60)]
    assert all(first.cause != second.cause for first, second in drawn)
    assert len({cause.cause for pair in drawn for cause in pair}) > 25
    assert drawn[7] == sample_injected_causes(settings("random", "random", seed=7))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("wobble", "'wobble' in the option --hide is not the name of a simulated error"),
        ("", "Run `gyrorigd causes` to list all names"),
        ("backlsh:1e-3", "id you mean backlash"),
        ("backlash:much", "a number in rad, for example 0.0009"),
        ("backlash:nan", "of the simulated error backlash is not a number"),
        ("backlash:-1e-3", "is -0.001, but it must not be negative"),
        ("backlash:3", "cannot have the size 3 "),
        ("saturation:0", "cannot have the size 0 "),
        ("lost_steps:1.5", "it must be a whole number"),
        ("random:3", "Write only --hide random"),
    ],
)
def test_what_cannot_be_is_refused_with_the_way_out(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=re.escape(words)) as refused:
        parse_injection(text)
    assert refused.value.exit_code == 2


@pytest.mark.parametrize(
    ("hide", "words"),
    [
        (("backlash@z",), "After @, write one of pan, tilt"),
        (("warm_up@tilt",), "After @, write one of x, y, z, GY80-1"),
        (("warm_up@C.x",), "cannot be applied to"),
        (("clock_offset@x",), "After @, write one of GY80-1"),
        (("earth_rotation@x",), "without @ and a place"),
        (("backlash@pan", "backlash@pan:1e-3"), "twice for the same place"),
        (("sample_jitter:5e-3",), "at most 0.00274"),
    ],
)
def test_what_does_not_fit_this_rig_is_refused(hide: Sequence[str], words: str) -> None:
    with pytest.raises(UsageError, match=re.escape(words)):
        sample_injected_causes(settings(*hide))


def test_drawn_jitter_fits_the_rate() -> None:
    fast = (BoardSettings(odr_hz=800.0, bandwidth_hz=110.0),)
    for seed in range(30):
        (hidden,) = sample_injected_causes(
            replace(settings("sample_jitter", seed=seed), boards=fast)
        )
        assert 0.0 < np.sqrt(12.0) * hidden.size.number < 1.0 / 840.0


def test_a_rig_without_boards_cannot_hide_a_boards_cause() -> None:
    with pytest.raises(UsageError, match="no board of this rig is emulated"):
        sample_injected_causes(replace(settings("warm_up"), boards=()))
    assert sample_injected_causes(replace(settings("backlash"), boards=()))[0].board is None


def test_lost_samples_are_missing_with_their_numbers() -> None:
    rig = EmulatedRig(settings("lost_samples:0.05"), 0)
    hub, data = VirtualHub(rig), b""
    while (chunk := hub.read(20_000_000_000)) is not None:
        data += chunk.data if chunk.port != "ptu" else b""
    frames = [e.frame for e in FrameParser().feed(data, 0) if isinstance(e, FrameEvent)]
    numbers = np.array([f.sequence for f in frames if isinstance(f, Sample)])
    missing = np.diff(numbers) - 1
    assert missing.min() == 0
    assert 2 <= missing.max() <= 8
    assert missing.sum() / len(numbers) == pytest.approx(0.05, rel=0.4)


def test_a_seal_holds_until_it_is_opened() -> None:
    document = sample_rig_truth(settings("backlash")).to_document()
    seal = TruthCommitment(document)
    assert set(seal.commitment_document()) == {"seal"}
    opened = json.loads(json.dumps(seal.revealed_document({**document, "more": 1})))
    assert (
        truth_digest(opened["hidden"])
        == opened["seal"]["sha256"]
        == seal.commitment_document()["seal"]["sha256"]
    )
    assert opened["hidden"]["causes"] == document["hidden"]["causes"]
    assert TruthCommitment(document).sha256 != seal.sha256  # cannot be guessed from the causes
    opened["hidden"]["causes"][0]["cause"] = "ringing"
    assert truth_digest(opened["hidden"]) != seal.sha256
