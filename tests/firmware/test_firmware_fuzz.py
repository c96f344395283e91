"""Random bytes and calls against the board, under the address and undefined sanitizers."""

import subprocess
from pathlib import Path

ROUNDS = 300_000


def test_random_input_has_no_effect(fuzzer: Path) -> None:
    process = subprocess.run(
        [fuzzer, "20261121", str(ROUNDS)], capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr
    inputs, frames, answers, faults = map(int, process.stdout.split())
    assert inputs > ROUNDS // 10
    assert frames > ROUNDS // 50
    assert answers > 100  # not everything was refused
    assert faults > 100
