"""Everything about one cause is in its own file: no other product code knows a cause.

A special case of the search, a text or a limit is an attribute of the cause (`model.term.Term`).
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from gyrorig_solver.model.catalogue import catalogue

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = {
    "solver/gyrorig_solver": "model/causes",
    "daemon/gyrorig_daemon": "emulator/causes",
}
NAMES_ITS_FINDING = "the check is the only detector of this cause, and names it"
APPLIES_PARAMETERS = "applies the parameters of a calibration by name, without the solver"
EXCEPTIONS = {
    "solver/gyrorig_solver/apply/calibration_file.py": APPLIES_PARAMETERS,
    "solver/gyrorig_solver/apply/calibration_correction.py": APPLIES_PARAMETERS,
    "solver/gyrorig_solver/data/stream/counter_gaps.py": NAMES_ITS_FINDING,
    "solver/gyrorig_solver/data/stream/damaged_words.py": NAMES_ITS_FINDING,
    "solver/gyrorig_solver/data/stream/exact_repeats.py": NAMES_ITS_FINDING,
    "solver/gyrorig_solver/data/stream/gain_checks.py": NAMES_ITS_FINDING,
    "solver/gyrorig_solver/data/stream/stuck_axes.py": NAMES_ITS_FINDING,
    "solver/gyrorig_solver/discover/attitude/attitude_terms.py": "the cards of two more causes",
    "solver/gyrorig_solver/discover/checks/jitter_cause.py": NAMES_ITS_FINDING,
    "solver/gyrorig_solver/discover/checks/jitter_estimate.py": NAMES_ITS_FINDING,
    "solver/gyrorig_solver/discover/checks/random_walk.py": NAMES_ITS_FINDING,
    "solver/gyrorig_solver/discover/checks/residual_dependence.py": "the variance by jitter",
    "solver/gyrorig_solver/export/c_header.py": APPLIES_PARAMETERS,
    "solver/gyrorig_solver/export/export_source.py": APPLIES_PARAMETERS,
    "solver/gyrorig_solver/export/flight_controllers.py": APPLIES_PARAMETERS,
    "solver/gyrorig_solver/export/kalibr.py": APPLIES_PARAMETERS,
    "solver/gyrorig_solver/export/ros.py": "a key of the other program",
    "solver/gyrorig_solver/fleet/drift/common_offsets.py": "a column of the store's index",
    "daemon/gyrorig_daemon/doctor/daemon_check.py": "a code of the doctor",
}


def cause_words(path: Path) -> Iterator[str]:
    """Yield the ids of causes that a module has as texts, and the files of causes it imports."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and node.value in catalogue():
            yield f"{node.lineno} {node.value!r}"
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            package, _, module = node.module.rpartition(".")
            if package.endswith(".causes") and module in catalogue():
                yield f"{node.lineno} import of {module}"


def other_modules(package: str) -> Iterator[Path]:
    causes = ROOT / package / PACKAGES[package]
    return (path for path in sorted((ROOT / package).rglob("*.py")) if path.parent != causes)


@pytest.mark.parametrize("package", PACKAGES)
def test_only_the_file_of_a_cause_knows_it(package: str) -> None:
    known = [
        f"{name}:{word}"
        for path in other_modules(package)
        if (name := path.relative_to(ROOT).as_posix()) not in EXCEPTIONS
        for word in cause_words(path)
    ]
    assert known == [], "make it an attribute of the cause"


@pytest.mark.parametrize("name", EXCEPTIONS)
def test_every_exception_is_needed(name: str) -> None:
    assert list(cause_words(ROOT / name))


@pytest.mark.parametrize("package", PACKAGES)
def test_a_cause_is_one_file(package: str) -> None:
    folder = ROOT / package / PACKAGES[package]
    assert {path.stem for path in folder.glob("*.py")} - {"__init__", "cause"} == set(catalogue())
