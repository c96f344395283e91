"""Every fuzz target withstands its seeds, inputs that once failed, and random inputs."""

import random
import subprocess
import sys
from pathlib import Path

import pytest
from tests.fuzz.all_targets import TARGETS, crash_inputs
from tests.fuzz.inject import KINDS, inject
from tests.fuzz.mutate import mutate
from tests.fuzz.target import GuaranteeError

INPUTS = 300


@pytest.mark.parametrize("name", TARGETS)
def test_a_target_withstands_random_input(name: str) -> None:
    target = TARGETS[name]
    seeds = list(target.seeds())
    assert seeds
    chance = random.Random(f"gyrorig {name}")
    for data in [b"", *seeds, *crash_inputs(name)]:
        target.run(data)
    for _ in range(INPUTS):
        target.run(mutate(chance, seeds, target.max_bytes))


def test_a_failing_target_is_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    from tests.fuzz import link_targets  # noqa: PLC0415

    monkeypatch.setattr(link_targets, "MAX_STUFFED_BYTES", 3)
    with pytest.raises(GuaranteeError, match="more is kept"):
        TARGETS["board_frames"].run(b"\x01" * 9)


def test_the_fuzzer_counts(tmp_path: Path) -> None:
    fuzzer = Path(__file__).with_name("fuzz.py")
    ended = subprocess.run(
        [sys.executable, fuzzer, "--chance", "--seconds", "0.2", "--out", tmp_path,
         "--target", "ptu_replies"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert "0 broken" in ended.stdout
    assert int(ended.stdout.split()[1]) > 20


@pytest.mark.parametrize("name", KINDS)
def test_no_damaged_frame_gives_a_wrong_sample(name: str) -> None:
    actual = inject(KINDS[name], 2000, f"test {name}")
    assert actual["wrong"] == 0
    assert actual["neighbours_lost"] <= 2000 * 0.2  # only if the delimiter between them was hit
