"""docs/accuracy.md holds what its script makes of the bench's results, and nothing else."""

from docs import blocks
from docs.accuracy import write


def test_the_page_has_the_results() -> None:
    text = write.DOCUMENT.read_text(encoding="utf-8")
    assert set(blocks.read_block_names(text)) == set(write.BLOCKS)
    for name, body in blocks.read_block_bodies(text).items():
        made = write.BLOCKS[name]() + "\n"
        assert blocks.describe_difference(body, made, 1e-9, 1.0) == ""
