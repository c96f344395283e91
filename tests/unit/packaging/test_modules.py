"""A module is worth a file: one that only its neighbour imports is part of the neighbour's file.

The exceptions are folders of alternatives with one of them per file, a module that is loaded only
where its library is installed, and a module whose names the package exports.
"""

import ast
from collections import defaultdict
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
FOLDERS = ("firmware_protocol/gyrorig_protocol", "daemon/gyrorig_daemon", "solver/gyrorig_solver")
MAX_LINES = 300
ENTRY_POINT = "cli"
ALTERNATIVES = {
    "gyrorig_daemon.commands": "one command per file",
    "gyrorig_daemon.doctor": "one check per file",
    "gyrorig_daemon.emulator.board.protocols": "one protocol per file",
    "gyrorig_daemon.emulator.causes": "one cause per file",
    "gyrorig_daemon.motion.drivers": "one driver per file",
    "gyrorig_daemon.links.can.python_can_line": "loads python-can",
    "gyrorig_protocol.board_protocols": "one protocol per file",
    "gyrorig_solver.data.stream": "one check per file",
    "gyrorig_solver.export": "one format per file",
    "gyrorig_solver.model.causes": "one cause per file",
    "gyrorig_solver.pipeline.references": "one kind of reference per file",
    "gyrorig_solver.storage": "one kind of storage per file",
    "gyrorig_solver.uncertainty.marginal_covariance": "a derivation that stands alone",
    "gyrorig_solver.uncertainty.prior_effects": "the projection, apart from the sums of the budget",
}


def product_modules() -> dict[str, Path]:
    """Return the modules of the three packages by dotted name, without packages."""
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts[1:]): path
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*.py"))
        if path.stem != "__init__"
    }


@cache
def imported_names(path: Path) -> frozenset[str]:
    """Return what a module imports, both as a module and as a name in one."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return frozenset(names)


def line_count(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def test_a_module_with_one_importer_is_in_the_file_of_its_importer() -> None:
    modules = product_modules()
    importers = defaultdict(set)
    for importer, path in modules.items():
        for name in modules.keys() & imported_names(path):
            importers[name].add(importer)
    small = []
    for module, path in modules.items():
        folder = module.rpartition(".")[0]
        if len(importers[module]) != 1 or not {module, folder}.isdisjoint(ALTERNATIVES):
            continue
        if module in imported_names(path.with_name("__init__.py")):
            continue
        (importer,) = importers[module]
        is_neighbour = importer.rpartition(".")[0] == folder and path.stem != ENTRY_POINT
        if is_neighbour and line_count(path) + line_count(modules[importer]) < MAX_LINES:
            small.append(f"{module} into {importer}")
    assert small == []
