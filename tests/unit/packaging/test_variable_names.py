"""A variable names its thing: participles and pronouns that name nothing are not used."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
NAMELESS = {"found", "told", "said", "one", "some", "there", "own", "beside", "done", "kept"}
# Keys of files, which keep their names.
FILE_KEYS = {
    "solver/gyrorig_solver/findings/findings_document.py": {"found", "said"},
    "solver/gyrorig_solver/fleet/store/index_rows.py": {"beside"},
    "tests/hidden/scoring/outcome.py": {"said"},
}
FOLDERS = ("daemon", "docs", "firmware_protocol", "release", "solver", "systemd", "tests")


def bound_names(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield the names that a module binds, with their lines."""
    for node in ast.walk(tree):
        match node:
            case ast.Name(id=name, ctx=ast.Store(), lineno=line):
                yield name, line
            case ast.Attribute(attr=name, ctx=ast.Store(), lineno=line):
                yield name, line
            case ast.arg(arg=name, lineno=line):
                yield name, line
            case ast.FunctionDef(name=name, lineno=line) | ast.ClassDef(name=name, lineno=line):
                yield name, line
            case ast.MatchAs(name=str(name), lineno=line):
                yield name, line
            case ast.MatchStar(name=str(name), lineno=line):
                yield name, line
            case ast.ExceptHandler(name=str(name), lineno=line):
                yield name, line


@pytest.mark.parametrize("folder", FOLDERS)
def test_variables_name_their_thing(folder: str) -> None:
    nameless = [
        f"{relative}:{line} {name}"
        for path in sorted((ROOT / folder).rglob("*.py"))
        for relative in [path.relative_to(ROOT).as_posix()]
        for name, line in bound_names(ast.parse(path.read_text(encoding="utf-8")))
        if name.strip("_") in NAMELESS - FILE_KEYS.get(relative, set())
    ]
    assert nameless == []
