"""docs/discovery-scores.md and its picture agree with the committed results."""

from docs import blocks
from tests.hidden import write_scores


def test_the_page_contains_the_results() -> None:
    text = write_scores.DOCUMENT.read_text(encoding="utf-8")
    assert set(blocks.read_block_names(text)) == set(write_scores.BLOCKS)
    for name, body in blocks.read_block_bodies(text).items():
        made = write_scores.BLOCKS[name]() + "\n"
        assert blocks.describe_difference(body, made, 1e-9, 1.0) == "", name


def test_the_picture_shows_the_results() -> None:
    assert write_scores.PICTURE.read_text(encoding="utf-8") == write_scores.make_picture()
