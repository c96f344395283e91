"""What `make test-docs` takes for a command, and what it does not let pass."""

import re
from pathlib import Path

import pytest
from tests.docs.blocks import DocumentError, blocks, pages
from tests.docs.places import CannotBeHereError, Place, Places
from tests.docs.run import Reader, Tally

ROOT = Path(__file__).parents[3]
ENDS_WELL = (
    'python3 -c "import pathlib, signal, sys; signal.signal(15, lambda *_: sys.exit(CODE)); '
    "pathlib.Path('there').touch(); signal.pause()\""
)


def followed(folder: Path, text: str) -> Tally:
    page = folder / "page.md"
    page.write_text(text)
    place = folder / "place"
    place.mkdir()
    with Places(folder / "no-data") as places:
        return Reader(place, places, has_data=False).follow(page)


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.name)
def test_every_page_says_how_its_blocks_are_taken(page: Path) -> None:
    list(blocks(page))


def test_what_is_left_to_ci_is_run_there() -> None:
    script = (ROOT / ".ci" / "run").read_text()
    alone = re.findall(r"^make PYTHON=\S+ (\S+)", script, re.M)
    ran = {*alone, *" ".join(re.findall(r"^begin \S+ (.*)", script, re.M)).split()}
    left = [block for page in pages() for block in blocks(page) if block.detail == "ci"]
    asked = {line for block in left for line in block.body.splitlines()}
    assert asked == {"make check", "make test"}
    assert {line.removeprefix("make ") for line in asked} <= ran


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
        "<!-- test: look: elsewhere -->\n```sh\nexit 1\nexit 2\n```\n"
        '```sh\nls "$GYRORIG_DATA"\n```\n',
    )
    assert (tally.failure, tally.ran, tally.looked) == ("", 0, {"elsewhere": 2, "data": 1})
    assert tally.summary() == "0 run, 3 looked at (data 1, elsewhere 2)"


def test_what_a_page_takes_for_done_is_done_before(tmp_path: Path) -> None:
    tally = followed(
        tmp_path,
        "<!-- test: after echo NAME=3 > name -->\n<!-- test: after . ./name -->\n"
        "```sh\ntest $NAME = 3\n```\n"
        "<!-- test: after echo 2 > two -->\n```python\nassert open('two').read() == '2\\n'\n```\n",
    )
    assert (tally.failure, tally.ran) == ("", 2)


def test_where_a_place_cannot_be_its_commands_are_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nowhere(places: Places, word: str, folder: Path) -> Place:
        raise CannotBeHereError("a container needs root")

    monkeypatch.setattr(Places, "place", nowhere)
    tally = followed(tmp_path, "<!-- test: in rig -->\n```sh\nfalse\nfalse\n```\n")
    assert tally.summary() == "0 run, 2 looked at (rig: a container needs root 2)"
    assert tally.failure == ""


def test_a_program_that_is_brought_elsewhere(tmp_path: Path) -> None:
    """What a place puts before a command, and the folder and words that it stands in there."""
    place = Place(tmp_path, {}, ("nsenter", "--net"))
    assert place.argv("ls") == ["nsenter", "--net", "env", f"--chdir={tmp_path}", "ls"]


@pytest.mark.parametrize("how", ["look", "look:", "look: laziness", "skip", "serve", "save"])
def test_no_block_is_passed_over_without_a_reason(tmp_path: Path, how: str) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"# x\n\n<!-- test: {how} -->\n```sh\ntrue\n```\n")
    with pytest.raises(DocumentError, match=r"page\.md:5"):
        list(blocks(page))


def test_a_file_that_cannot_be_saved_is_a_failure_of_its_page(tmp_path: Path) -> None:
    tally = followed(
        tmp_path, "```sh\ntouch file\n```\n<!-- test: save file/a.yaml -->\n```yaml\nx: 1\n```\n"
    )
    assert tally.failure.startswith("page.md:6: ")
    assert "file" in tally.failure
    assert tally.ran == 1


def test_what_fails_is_named_by_page_and_line(tmp_path: Path) -> None:
    tally = followed(tmp_path, "# x\n```sh\necho gone >&2; false\n```\n```sh\ntrue\n```\n")
    assert tally.failure == "page.md:3: exit status 1: ['gone']"
    assert tally.ran == 0


@pytest.mark.parametrize(("code", "failure"), [(0, ""), (3, "page.md:4: exit status 3")])
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
    result = followed(tmp_path, f"```sh\n{ours}gyrorig leave 4\ngyrorigd leave 4\n```\n")
    assert result.failure == ""
    for program in ("gyrorig", "gyrorigd"):
        folder = tmp_path / program
        folder.mkdir()
        refused = followed(folder, f"```sh\n{ours}{program} leave 3\n```\n")
        assert refused.failure.startswith("page.md:2: exit status 3")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("```\ngyrorig solve a.mcap\n```\n", "commands must be in a block ```sh"),
        ("```text\n$ sudo make install-service\n```\n", "commands must be in a block ```sh"),
        ("<!-- test: look: no time -->\n```sh\nmake\n```\n", "look 'no time': use one of"),
        ("<!-- test: in a dream -->\n```sh\nmake\n```\n", "in 'a dream': use one of"),
        ("<!-- test: serve -->\n```sh\nmake\n```\n", "unknown mark 'serve'"),
        ("<!-- test: later -->\n```sh\nmake\n```\n", "unknown mark 'later'"),
    ],
)
def test_a_block_that_nobody_would_run_is_refused(tmp_path: Path, text: str, message: str) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"# A page\n\n```text\nrig  running\n```\n\n{text}")
    with pytest.raises(DocumentError, match=re.escape(message)) as refused:
        list(blocks(page))
    assert str(refused.value).startswith("page.md:")


def test_marks_of_a_block(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "<!-- test: in rig -->\n<!-- test: after one --out a -->\n<!-- test: after two -->\n"
        "```sh\nls\n\nsudo ls\n```\n<!-- test: save a.yaml -->\n```yaml\na: 1\n```\n"
        "```yaml\nb: 1\n```\n```python\nprint(1)\nprint(2)\n```\n"
    )
    rig, save, python = blocks(page)
    assert (rig.how, rig.place, rig.before, rig.count) == (
        "run", "rig", ("one --out a", "two"), 2,
    )  # fmt: skip
    assert (save.how, save.detail, save.body, save.count) == ("save", "a.yaml", "a: 1\n", 0)
    assert (python.kind, python.count, python.line) == ("python", 1, 17)
