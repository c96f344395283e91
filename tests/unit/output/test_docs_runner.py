"""What `make test-docs` takes for a command, and what it does not let pass."""

from pathlib import Path

import pytest
from tests.docs.run import REASONS, DocumentError, Reader, Tally, blocks, pages

ENDS_WELL = (
    'python3 -c "import pathlib, signal, sys; signal.signal(15, lambda *_: sys.exit(CODE)); '
    "pathlib.Path('there').touch(); signal.pause()\""
)


def followed(folder: Path, text: str) -> Tally:
    page = folder / "page.md"
    page.write_text(text)
    place = folder / "place"
    place.mkdir()
    return Reader(place, folder / "no-data").follow(page)


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.name)
def test_every_page_says_how_its_blocks_are_taken(page: Path) -> None:
    list(blocks(page))


def test_a_page_is_run_from_the_top(tmp_path: Path) -> None:
    tally = followed(
        tmp_path,
        "```sh\necho 3 > three\ntest -f config/rig.yaml\n```\n"
        "<!-- test: save a.yaml -->\n```yaml\nx: 1\n```\n"
        "```yaml\nnot: saved\n```\n"
        "```python\nassert open('three').read() + open('a.yaml').read() == '3\\nx: 1\\n'\n```\n",
    )
    assert (tally.failure, tally.ran, tally.looked) == ("", 3, {})


def test_what_is_only_looked_at_is_counted_by_its_reason(tmp_path: Path) -> None:
    tally = followed(
        tmp_path,
        '<!-- test: look: root -->\n```sh\nexit 1\nexit 2\n```\n```sh\nls "$GYRORIG_DATA"\n```\n',
    )
    assert (tally.failure, tally.ran, tally.looked) == ("", 0, {"root": 2, "data": 1})
    assert tally.said() == "0 run, 3 looked at (data 1, root 2)"


@pytest.mark.parametrize("how", ["look", "look:", "look: laziness", "skip", "serve", "save"])
def test_no_block_is_passed_over_without_a_reason(tmp_path: Path, how: str) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"# x\n\n<!-- test: {how} -->\n```sh\ntrue\n```\n")
    with pytest.raises(DocumentError, match=r"page\.md:5"):
        list(blocks(page))
    assert REASONS


def test_what_fails_is_named_by_page_and_line(tmp_path: Path) -> None:
    tally = followed(tmp_path, "# x\n```sh\necho gone >&2; false\n```\n```sh\ntrue\n```\n")
    assert tally.failure == "page.md:3: left with 1: ['gone']"
    assert tally.ran == 0


@pytest.mark.parametrize(("code", "failure"), [(0, ""), (3, "page.md:4: left with 3")])
def test_what_serves_goes_on_and_has_to_end_well(tmp_path: Path, code: int, failure: str) -> None:
    served = ENDS_WELL.replace("CODE", str(code))
    tally = followed(
        tmp_path,
        f"# x\n<!-- test: serve there -->\n```sh\n{served}\n```\n```sh\ntest -f there\n```\n",
    )
    assert tally.ran == 2
    assert tally.failure.startswith(failure)
    assert bool(tally.failure) == bool(failure)


def test_four_is_done_with_something_left_open(tmp_path: Path) -> None:
    """Exit code 4 of our commands is no failure; 3 is one."""
    ours = 'command() { return "$3"; }\n'  # stands for the program: leaves with what it is told
    done = followed(tmp_path, f"```sh\n{ours}gyrorig leave 4\ngyrorigd leave 4\n```\n")
    assert done.failure == ""
    for program in ("gyrorig", "gyrorigd"):
        folder = tmp_path / program
        folder.mkdir()
        refused = followed(folder, f"```sh\n{ours}{program} leave 3\n```\n")
        assert refused.failure.startswith("page.md:2: left with 3")
