"""docs/discovery-scores.md and its picture agree with the committed results."""

from docs import blocks
from tests.hidden import write_scores


def test_the_page_has_the_results() -> None:
    text = write_scores.DOCUMENT.read_text(encoding="utf-8")
    assert set(blocks.block_names(text)) == set(write_scores.BLOCKS)
    for name, body in blocks.bodies(text).items():
        made = write_scores.BLOCKS[name]() + "\n"
        assert blocks.unlike(body, made, 1e-9, 1.0) == "", name


def test_the_picture_has_the_results() -> None:
    assert write_scores.PICTURE.read_text(encoding="utf-8") == write_scores.picture()
