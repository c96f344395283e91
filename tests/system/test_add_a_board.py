"""The page on a new protocol, followed to the letter: saved, recorded, solved, compared."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from tests.docs.blocks import Block, blocks

from gyrorig_protocol.recording.reader import read_recording

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "how-to" / "add-a-board.md"
BIN = Path(sys.executable).parent


def run_block(block: Block, folder: Path) -> str:
    """Run the commands of a block, and return what they print."""
    environment = {**os.environ, "PATH": f"{BIN}:{os.environ['PATH']}"}
    process = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block.body],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, f"{block.where}: {process.stderr}"
    return process.stdout


def follow_page(folder: Path) -> str:
    """Save and run every block of the page, and return what the last one prints."""
    (folder / "config").symlink_to(ROOT / "config")
    printed = ""
    for block in blocks(PAGE):
        if block.how == "save":
            (folder / block.detail).write_text(block.body, encoding="utf-8")
        else:
            printed = run_block(block, folder)
    return printed


@pytest.mark.long
def test_the_example_of_the_page_is_recorded_and_solved(tmp_path: Path) -> None:
    printed = follow_page(tmp_path)
    (path,) = (tmp_path / "recordings").glob("*mini.mcap")
    recording = read_recording(path)
    assert recording.losses == ()
    metadata = recording.metadata["gyrorig.board.MINI-1"]
    assert metadata["tick_hz"] == "1000000.0"
    assert metadata["counter_bits"] == "32"
    document = yaml.safe_load((tmp_path / "calibrations/MINI-1/v0001.yaml").read_text())
    assert document["trust"]["verdict"] == "good"
    # The last command prints each difference in standard uncertainties.
    scores = [abs(float(z)) for z in re.findall(r"(-?\d+\.\d+)\s*$", printed, re.MULTILINE)]
    assert len(scores) >= 9
    assert max(scores) < 4.0
