"""Names say one thing: module and class names are unique, class names are nouns of the glossary."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest
from docs import layers

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = {
    "gyrorig_protocol": ROOT / "firmware_protocol" / "gyrorig_protocol",
    "gyrorig_daemon": ROOT / "daemon" / "gyrorig_daemon",
    "gyrorig_solver": ROOT / "solver" / "gyrorig_solver",
}
ENTRY_POINTS = {"__init__", "__main__", "cli"}


def modules(package: str) -> Iterator[Path]:
    return (path for path in sorted(PACKAGES[package].rglob("*.py")) if path.stem != "__init__")


def public_classes(path: Path) -> Iterator[str]:
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield node.name


def used_more_than_once(places: dict[str, list[str]]) -> dict[str, list[str]]:
    return {name: paths for name, paths in places.items() if len(paths) > 1}


@pytest.mark.parametrize("package", PACKAGES)
def test_no_module_name_occurs_twice_in_a_package(package: str) -> None:
    places = defaultdict(list)
    for path in modules(package):
        places[path.stem].append(str(path.relative_to(ROOT)))
    assert used_more_than_once(places) == {}


@pytest.mark.parametrize("package", PACKAGES)
def test_no_public_class_name_occurs_twice_in_a_package(package: str) -> None:
    places = defaultdict(list)
    for path in modules(package):
        for name in public_classes(path):
            places[name].append(str(path.relative_to(ROOT)))
    assert used_more_than_once(places) == {}


@pytest.mark.parametrize("package", ["gyrorig_daemon", "gyrorig_solver"])
def test_only_entry_points_are_at_the_top_of_a_package(package: str) -> None:
    assert {path.stem for path in PACKAGES[package].glob("*.py")} <= ENTRY_POINTS


@pytest.mark.parametrize("package", PACKAGES)
def test_every_package_says_what_is_in_it(package: str) -> None:
    for path in PACKAGES[package].rglob("__init__.py"):
        docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        assert len(docstring.split()) >= 5, f"{path.relative_to(ROOT)} does not say what is here"


def test_the_drawing_of_the_layers_shows_the_imports() -> None:
    drawn = layers.PICTURE.read_text(encoding="utf-8")
    assert drawn == layers.draw_layers(), "run `python -m docs.layers`"
