"""docs/paper.md holds what its scripts print, and no other measured number."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from docs import blocks
from docs.paper import draw_figures, end_to_end, write

PRINTED_IN_THE_PAPER = {"0.07445", "5.93", "0.96"}
DECIMAL = re.compile(r"\d+\.\d+")


@pytest.fixture(scope="module")
def document() -> str:
    return write.DOCUMENT.read_text(encoding="utf-8")


@pytest.mark.pages
def test_blocks_are_what_the_scripts_give(document: str) -> None:
    assert blocks.replace_blocks(document, write.QUICK) == document


def test_every_block_is_in_the_document_once(document: str) -> None:
    names = blocks.read_block_names(document)
    assert len(set(names)) == len(names)
    assert set(names) == {*write.QUICK, *end_to_end.BLOCKS}


def test_decimals_in_prose_stand_in_a_block_too(document: str) -> None:
    """A number that is written by hand is one that a script printed."""
    made = " ".join(blocks.read_block_bodies(document).values())
    prose = blocks.BLOCK.sub("", document)
    by_hand = set(DECIMAL.findall(prose)) - PRINTED_IN_THE_PAPER
    assert {number for number in by_hand if number not in made} == set()


def test_a_changed_number_is_found(document: str) -> None:
    changed = document.replace("0.07445", "0.07446")
    assert blocks.replace_blocks(changed, {"table-1": write.QUICK["table-1"]}) != changed


@pytest.mark.pages
def test_end_to_end_blocks_are_what_the_rig_gives(document: str) -> None:
    """Records and solves: the words must agree, a number within 10 % or five of its last digit.

    Exact digits would tie the document to one processor's rounding, and to the
    millisecond in which each command of the emulated session goes out.
    """
    bodies = blocks.read_block_bodies(document)
    for name, block in end_to_end.BLOCKS.items():
        assert blocks.describe_difference(bodies[name], block() + "\n", 0.10, 5.0) == "", name


def test_figures_are_there_and_small(document: str, tmp_path: Path) -> None:
    drawn = draw_figures.draw(tmp_path)
    assert len(drawn) == 7
    for file in drawn:
        figure = draw_figures.FIGURES / file.name
        assert figure.stat().st_size < 100_000
        assert file.stat().st_size < 100_000
        assert f"(paper/figures/{file.name})" in document


def test_a_script_runs_on_its_own(tmp_path: Path) -> None:
    """As a reader runs it, from any folder."""
    script = Path(draw_figures.__file__).with_name("check_tables.py")
    run = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert "## table-3-products" in run.stdout
    assert run.stderr == ""
