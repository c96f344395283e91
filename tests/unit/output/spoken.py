"""Every text of the product's code that somebody may read, by place: the source is asked.

What to use when: `errors` for what is raised, with its remedy; `findings` for what `gyrorigd
doctor` says; `texts` for all strings of more than a word, these among them.
"""

import ast
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[3]
PARTS = ("firmware_protocol", "daemon", "solver")
ERRORS = ("UsageError", "InputError", "DeviceError", "MachineError", "BusyError", "PortsGoneError")
FINDINGS = ("fault", "warning", "note")


class UserText(NamedTuple):
    """One text; what is put into it stands in braces, as its source."""

    place: str  # path:line
    kind: str
    text: str
    remedy: str | None = None


def errors() -> Iterator[UserText]:
    """Yield every error of the tree that is made in the product."""
    for module in _modules():
        yield from module.errors


def findings() -> Iterator[UserText]:
    """Yield every finding of the doctor: subject, code, what, remedy."""
    for module in _modules():
        yield from module.findings


def texts() -> Iterator[UserText]:
    """Yield every string of more than a word that is no docstring."""
    for module in _modules():
        yield from module.texts


class _ModuleTexts(NamedTuple):
    errors: tuple[UserText, ...]
    findings: tuple[UserText, ...]
    texts: tuple[UserText, ...]


@cache
def _modules() -> tuple[_ModuleTexts, ...]:
    """Return the texts of each module of the product.

    The syntax trees are not kept: a million nodes would slow every later garbage collection.
    """
    return tuple(
        _texts_of_module(path) for part in PARTS for path in sorted((ROOT / part).rglob("*.py"))
    )


def _texts_of_module(path: Path) -> _ModuleTexts:
    place = path.relative_to(ROOT).as_posix()
    nodes = tuple(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))  # breadth first
    functions = [node for node in nodes if isinstance(node, ast.FunctionDef)]
    return _ModuleTexts(
        tuple(_errors_of(place, nodes)),
        tuple(
            finding
            for function in functions
            if "/doctor/" in place
            for finding in _findings_of(place, function)
        ),
        tuple(_texts_of(place, nodes)),
    )


def _errors_of(path: str, nodes: Sequence[ast.AST]) -> Iterator[UserText]:
    for node in nodes:
        if isinstance(node, ast.Call) and _name(node.func) in ERRORS and node.args:
            remedy = rendered(node.args[1]) if len(node.args) > 1 else None
            yield UserText(_place(path, node), _name(node.func), rendered(node.args[0]), remedy)


def _findings_of(path: str, function: ast.FunctionDef) -> Iterator[UserText]:
    """Yield the findings of one function, with its local texts in place of their names."""
    nodes = sorted(
        (node for node in ast.walk(function) if isinstance(node, ast.stmt | ast.expr)),
        key=lambda node: (node.lineno, node.col_offset),
    )
    local_texts: dict[str, str] = {}
    for node in nodes:
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                local_texts[name] = rendered(value)
            case ast.Call(func=called, args=[_, _, what, *more]) if _name(called) in FINDINGS:
                texts = (rendered(arg) for arg in (what, *more[:1]))
                filled = [_filled(text, local_texts) for text in texts]
                yield UserText(_place(path, node), _name(called), *filled)


def _filled(text: str, local_texts: dict[str, str]) -> str:
    """Return a text with the local texts that it names."""
    for name, value in local_texts.items():
        if " " in value.strip("{}"):
            text = text.replace(f"{{{name}}}", value)
    return text


def _texts_of(path: str, nodes: Sequence[ast.AST]) -> Iterator[UserText]:
    docstrings = {
        id(body[0].value)
        for body in (getattr(node, "body", None) for node in nodes)
        if isinstance(body, list) and body and isinstance(body[0], ast.Expr)
    }
    inside: set[int] = set()
    for node in nodes:
        if id(node) in docstrings or id(node) in inside:
            continue
        if isinstance(node, ast.JoinedStr):
            inside |= {id(part) for part in ast.walk(node)}
        if not isinstance(node, ast.JoinedStr | ast.Constant):
            continue
        if isinstance(node, ast.Constant) and not isinstance(node.value, str):
            continue
        if " " in (text := rendered(node)).strip():
            yield UserText(_place(path, node), "text", text)


def rendered(node: ast.expr) -> str:
    """Return a text as it will be read, as far as the source tells."""
    match node:
        case ast.Constant(value=str() as text):
            return text
        case ast.JoinedStr(values=parts):
            return "".join(
                rendered(part) if isinstance(part, ast.Constant) else f"{{{_source(part)}}}"
                for part in parts
            )
        case ast.BinOp(left=left, right=right):
            return rendered(left) + rendered(right)
        case ast.IfExp(body=body, orelse=other):
            return f"{rendered(body)} | {rendered(other)}"
    return f"{{{ast.unparse(node)}}}"


def _source(part: ast.expr) -> str:
    return ast.unparse(part.value) if isinstance(part, ast.FormattedValue) else ast.unparse(part)


def _name(function: ast.expr) -> str:
    return function.id if isinstance(function, ast.Name) else getattr(function, "attr", "")


def _place(path: str, node: ast.expr) -> str:
    return f"{path}:{node.lineno}"
