"""The documentation and the program's texts are in plain words (see `check.py`)."""

from pathlib import Path

import pytest
from tests.prose.check import (
    Hit,
    Words,
    find_all,
    find_new,
    known_counts,
    newest_section,
    page_hits,
    sentences,
    strip_code,
)


def words_in(text: str) -> list[str]:
    return [hit.text for hit in page_hits("page.md", text, Words())]


@pytest.mark.long  # `make check` does the same
def test_no_file_has_more_private_words_than_recorded() -> None:
    new = find_new(find_all(), known_counts())
    assert not [f"{hit.path}:{hit.line}: {hit.text!r}; use: {hit.instead}" for hit in new]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("The unit is told to move.", "told"),
        ("A file says so.", "says"),
        ("It is read anew.", "anew"),
        ("This IS no recording.", "IS no "),
        ("It leaves with 4.", "leaves with 4"),
        ("The time of a stamp.", "stamp"),
        ("It runs 5 times a second.", "5 times a second"),
        ("The fit settles.", "settles"),
        ("What is measured is the rate.", "What is measured is the rate."),
    ],
)
def test_private_words_are_found(text: str, word: str) -> None:
    assert words_in(text) == [word]


@pytest.mark.parametrize(
    "text",
    [
        "There is no longer a limit, and it is no more than 5.",
        "The timestamp of a sample, five times per second.",
        "What is a calibration? It is a file.",
        "The key `beside`, and ``told `` twice.",
        "```sh\necho told beside\n```",
        "<!-- test: says -->",
        "[the page](told.md)",
        "Wait until the settle time has passed.",
    ],
)
def test_plain_words_and_code_are_not_found(text: str) -> None:
    assert words_in(text) == []


def test_lines_are_those_of_the_file() -> None:
    text = "# Title\n\n```sh\ntold\n```\n\nOne line.\nIt is told.\n"
    assert [(hit.line, hit.text) for hit in page_hits("p.md", text, Words())] == [(8, "told")]
    assert strip_code(text).count("\n") == text.count("\n")


def test_sentences_are_split_at_stops_paragraphs_and_list_items() -> None:
    text = "# Title\n\nOne. Two\nlines.\n\n- three\n- four\n\n| a | b |\n"
    assert [text for _, text in sentences(text) if text] == ["One.", "Two lines.", "three", "four"]


def test_only_the_newest_section_of_the_change_log_is_read() -> None:
    assert newest_section("# Log\n\n## 2\nnew\n\n## 1\nold\n") == "# Log\n\n## 2\nnew\n\n"
    assert newest_section("# Log\n") == "# Log\n"


def test_a_file_may_have_the_recorded_hits_and_no_more() -> None:
    hits = [Hit("a.md", 1, "told", ""), Hit("a.md", 2, "told", ""), Hit("b.md", 1, "anew", "")]
    assert find_new(hits, {"a.md": 2, "b.md": 1}) == []
    assert find_new(hits, {"a.md": 1, "b.md": 1}) == hits[:2]
    assert find_new(hits, {"a.md": 2}) == hits[2:]


def test_every_legitimate_use_has_a_reason(tmp_path: Path) -> None:
    path = tmp_path / "words.toml"
    path.write_text(
        "[avoid]\n'told' = 'reported'\n[[allow]]\nin = 'docs/'\ntext = 'told you'\nreason = 'x'\n"
    )
    words = Words(path)
    assert list(words.hits("docs/a.md", 1, "I told you so")) == []
    assert len(list(words.hits("docs/a.md", 1, "told"))) == 1
    assert len(list(words.hits("README.md", 1, "I told you so"))) == 1
