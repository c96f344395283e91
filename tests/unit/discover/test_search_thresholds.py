"""The page of thresholds lists every number of the search, with its value."""

import importlib
import pkgutil
import re
from pathlib import Path

import gyrorig_solver.discover

PAGE = Path(__file__).resolve().parents[3] / "docs" / "search-thresholds.md"
ROW = re.compile(r"^\| `([a-z_.]+)\.([A-Z][A-Z0-9_]+)` \| (\S+) \|", re.MULTILINE)
PACKAGE = gyrorig_solver.discover.__name__
ASSIGNMENT = re.compile(r"^([A-Z][A-Z0-9_]+(?:, [A-Z0-9_]+)*)(?:: [^=]+)? = ", re.MULTILINE)


INDICES = ("FLICKER", "WALK")  # of arrays of noise levels


def constants_of_the_search() -> dict[tuple[str, str], float]:
    """Return the numbers that modules of the search define, by module and name."""
    constants = {}
    for info in pkgutil.walk_packages(gyrorig_solver.discover.__path__, f"{PACKAGE}."):
        module = importlib.import_module(info.name)
        source = Path(str(module.__file__)).read_text(encoding="utf-8")
        for name in ", ".join(ASSIGNMENT.findall(source)).split(", "):
            if not name or name in INDICES:
                continue
            value = getattr(module, name)
            if isinstance(value, int | float) and not aliases(source, name):
                constants[info.name.removeprefix(f"{PACKAGE}."), name] = float(value)
    return constants


def aliases(source: str, name: str) -> bool:
    """Return whether a constant is another constant by another name."""
    return re.search(rf"^{name} = [A-Z_]+( |$)", source, re.MULTILINE) is not None


def test_the_page_lists_every_number_with_its_value() -> None:
    rows = ROW.findall(PAGE.read_text(encoding="utf-8"))
    listed = {(module, name): float(value) for module, name, value in rows}
    assert len(listed) == len(rows)
    constants = constants_of_the_search()
    assert len(constants) > 90
    assert {key for key in constants if key not in listed} == set()
    assert {key for key in listed if key not in constants} == set()
    assert {key: value for key, value in listed.items() if value != constants[key]} == {}
