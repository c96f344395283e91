"""The comparison of a page's printed output with the real one."""

from pathlib import Path

import pytest
from tests.docs.blocks import DocumentError, blocks
from tests.docs.output import first_difference

PAGE = "GY80-1: good\n  scale.x   +1.00010 ± 0.00026\n  file *_first.mcap\n"


@pytest.mark.parametrize(
    "printed",
    [
        "GY80-1: good\n  scale.x +1.00010 ± 0.00026\n  file 20260101_first.mcap\n",
        "GY80-1: good\n  scale.x    +1.00011 ± 0.00025\n\n  file a_first.mcap\n",
    ],
)
def test_spaces_last_digits_and_wildcards_may_differ(printed: str) -> None:
    assert first_difference(PAGE, printed) == ""


@pytest.mark.parametrize(
    ("printed", "shown"),
    [
        ("GY80-1: limited\n", "GY80-1: limited"),
        ("GY80-1: good\n  scale.x +1.00030 ± 0.00026\n", "+1.00030"),
        ("GY80-1: good\n", "nothing more"),
        ("GY80-2: good\n", "GY80-2"),
        (PAGE + "one line more\n", "one line more"),
    ],
)
def test_another_output_is_a_difference(printed: str, shown: str) -> None:
    assert shown in first_difference(PAGE, printed)


def test_dots_stand_for_lines() -> None:
    assert first_difference("a 1\n...\nb 2\n", "a 1\nx\ny\nb 2\n") == ""
    assert first_difference("a 1\n...\n", "a 1\nx\n") == ""
    assert "'b 2'" in first_difference("a 1\n...\nb 2\n", "a 1\nx\nb 3\n")


def test_integers_are_exact() -> None:
    assert first_difference("12 of 12\n", "11 of 12\n")


def test_a_page_attaches_output_to_the_commands_above(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("```sh\nls\n```\n\n<!-- test: output -->\n```text\na\n```\n", encoding="utf-8")
    (block,) = blocks(page)
    assert block.output == "a\n"
    page.write_text("<!-- test: output -->\n```text\na\n```\n", encoding="utf-8")
    with pytest.raises(DocumentError, match="output follows"):
        list(blocks(page))


def test_a_page_can_permit_more_units_of_the_last_digit() -> None:
    page, printed = "scale.y +0.9920 -0.12 u", "scale.y +0.9921 -0.09 u"
    assert first_difference(page, printed)
    assert not first_difference(page, printed, last_digits=3)
    assert first_difference(page, printed, last_digits=2)
