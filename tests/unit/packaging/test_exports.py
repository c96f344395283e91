"""What a package of the solver exports is its public part; the rest is private to the package.

A name that two or more modules of other packages import is exported by the package's `__init__`,
and other packages import an exported name from there. A name with one user outside may be imported
from its module. A name that starts with an underscore is never imported from another module.
"""

import ast
from collections import defaultdict
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

SOLVER = Path(__file__).resolve().parents[3] / "solver" / "gyrorig_solver"
PREFIX = "gyrorig_solver."
# Packages of subpackages: each subpackage exports its own names.
GROUPS = ("fleet", "commands")
# Names that their package cannot export, with the reason.
BY_MODULE = {
    "data": "applying a calibration needs numpy alone; `samples` loads scipy and the MCAP reader",
    "calibration": "applying a calibration needs numpy alone; the other modules load scipy",
}
ENTRY_POINTS = ("cli", "__main__")


@cache
def public_packages() -> tuple[str, ...]:
    """Return the dotted names, below the solver, of the packages that other packages import."""
    folders = [path.parent for path in sorted(SOLVER.glob("*/__init__.py"))]
    groups = [folder for folder in folders if folder.name in GROUPS]
    inner = [path.parent for group in groups for path in sorted(group.glob("*/__init__.py"))]
    packages = [folder for folder in folders if folder not in groups] + inner
    return tuple(".".join(folder.relative_to(SOLVER).parts) for folder in packages)


def package_of(module: str) -> str | None:
    """Return the public package of a module; both are dotted names below the solver."""
    parts = module.split(".")
    names = (".".join(parts[:count]) for count in (2, 1))
    return next((name for name in names if name in public_packages()), None)


@cache
def exported_names(package: str) -> dict[str, str]:
    """Return the module of each name that a package exports."""
    tree = ast.parse((SOLVER.joinpath(*package.split(".")) / "__init__.py").read_text("utf-8"))
    return {
        alias.name: node.module.removeprefix(PREFIX)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    }


@cache
def imports() -> tuple[tuple[str, str, str], ...]:
    """Return file, module and name of each import from the solver, dotted and below the solver."""
    return tuple(
        (
            ".".join(path.relative_to(SOLVER).with_suffix("").parts),
            node.module.removeprefix(PREFIX),
            alias.name,
        )
        for path in sorted(SOLVER.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(PREFIX)
        for alias in node.names
    )


@cache
def outside_imports() -> tuple[tuple[str, str, str], ...]:
    """Return the imports of a package of the solver by another one."""
    return tuple(
        entry for entry in imports() if package_of(entry[1]) not in (None, package_of(entry[0]))
    )


def is_cause(module: str) -> bool:
    """Whether a module is one of the catalogue's causes, of which each stands alone."""
    return module.startswith("model.causes.")


def test_an_exported_name_is_imported_from_its_package() -> None:
    wrong = [
        f"{importer} imports {name} from {module}"
        for importer, module, name in outside_imports()
        if exported_names(str(package_of(module))).get(name) == module
    ]
    assert not wrong, "\n".join(wrong)


def test_a_package_exports_every_name_that_two_other_modules_use() -> None:
    users = defaultdict(set)
    for importer, module, name in outside_imports():
        if module != package_of(module) and not is_cause(module):
            users[module, name].add(importer)
    wrong = [
        f"{module}.{name} is used by {', '.join(sorted(importers))}"
        for (module, name), importers in users.items()
        if len(importers) > 1
        and package_of(module) not in BY_MODULE
        and name != module.rsplit(".", maxsplit=1)[-1]  # would hide its module
    ]
    assert not wrong, "\n".join(wrong)


def test_private_names_stay_in_their_module() -> None:
    wrong = [
        f"{importer} imports {name} from {module}"
        for importer, module, name in imports()
        if name.startswith("_") and not name.startswith("__")
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("package", public_packages())
def test_a_package_says_what_to_use_and_exports_names(package: str) -> None:
    path = SOLVER.joinpath(*package.split(".")) / "__init__.py"
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert ast.get_docstring(tree)
    if package in {package_of(module) for _, module, _ in outside_imports()}:
        assert exported_names(package)


def test_folders_beside_each_other_do_not_import_each_other_in_a_circle() -> None:
    folders = {path.parent.relative_to(SOLVER).parts for path in SOLVER.rglob("__init__.py")}
    needs = defaultdict(set)
    for importer, module, _ in imports():
        importer_path, module_path = importer.split("."), module.split(".")
        pairs = zip(importer_path, module_path, strict=False)
        depth = next((k for k, (a, b) in enumerate(pairs) if a != b), 0)
        user, used = tuple(importer_path[: depth + 1]), tuple(module_path[: depth + 1])
        if user != used and user in folders and used in folders:
            needs[user].add(used)
    TopologicalSorter(needs).prepare()  # raises CycleError
