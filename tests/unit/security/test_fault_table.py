"""docs/faults.md names tests that exist, and every fault once."""

import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "faults.md").read_text()
SHORT = dict(re.findall(r"\b([A-Z][A-Z0-9]*) `(tests/[\w/]+\.py)`", PAGE))
NAMED = sorted(set(re.findall(r"([A-Z][A-Z0-9]*|tests/[\w/]+\.py)::(test_\w+)", PAGE)))


@cache
def functions_of(path: Path) -> set[str]:
    return set(re.findall(r"^def (test_\w+)", path.read_text(), re.MULTILINE))


def test_short_names_are_files() -> None:
    assert SHORT
    missing = [path for path in SHORT.values() if not (ROOT / path).is_file()]
    assert missing == []


@pytest.mark.parametrize(("place", "test"), NAMED, ids=lambda name: name.removeprefix("tests/"))
def test_named_tests_exist(place: str, test: str) -> None:
    path = ROOT / SHORT.get(place, place)
    assert path.is_file(), f"{place} is no file"
    assert test in functions_of(path)


def test_every_fault_has_a_row() -> None:
    rows = [int(number) for number in re.findall(r"^\| (\d+) \|", PAGE, re.MULTILINE)]
    assert rows == list(range(1, 28))
