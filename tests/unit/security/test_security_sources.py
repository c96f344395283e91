"""What no line of the product may do: run what it reads, unpickle, listen to a network.

By the syntax tree of every product module, so that a new one is looked at too. What is let
through is named here with its reason.
"""

import ast
import unicodedata
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PRODUCT = sorted(
    path
    for package in (
        "daemon/gyrorig_daemon",
        "solver/gyrorig_solver",
        "firmware_protocol",
        "systemd",
    )
    for path in (ROOT / package).rglob("*.py")
)
UNPICKLING = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal", "joblib"}
RUNNING = {"eval", "exec", "compile", "__import__"}
NETWORK_FAMILIES = {"AF_INET", "AF_INET6", "create_server", "create_connection"}
# python-can's UDP multicast kind of a bus, for where there is no CAN: only when configured
NETWORK_ALLOWED = {"multicast_line.py", "pty_server.py"}


def trees(*words: str) -> Iterator[tuple[Path, ast.AST]]:
    """Yield the product's modules that contain one of the words; only these are parsed."""
    for path in PRODUCT:
        text = path.read_text(encoding="utf-8")
        normal_text = unicodedata.normalize("NFKC", text)  # Python compares names in this form
        if any(word in normal_text for word in words):
            yield path, ast.parse(text)


def dotted_name(node: ast.expr) -> str:
    """Return `a.b.c`; what is neither a name nor an attribute is left out: `.c` of `f().c`."""
    if isinstance(node, ast.Attribute):
        return f"{dotted_name(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def calls(tree: ast.AST) -> Iterator[tuple[str, ast.Call]]:
    """Every call with its dotted name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            yield dotted_name(node.func), node


def where(path: Path, node: ast.expr | ast.stmt) -> str:
    return f"{path.relative_to(ROOT)}:{node.lineno}"


def test_there_is_something_to_look_at() -> None:
    assert len(PRODUCT) > 150


def test_nothing_is_unpickled() -> None:
    places = []
    for path, tree in trees("load", *UNPICKLING):
        for node in ast.walk(tree):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            if any(name.split(".")[0] in UNPICKLING for name in names):
                places.append(str(path.relative_to(ROOT)))
        for name, call in calls(tree):
            if name.endswith(("np.load", "numpy.load")):
                allowed = {word.arg: ast.unparse(word.value) for word in call.keywords}
                if allowed.get("allow_pickle") != "False":
                    places.append(where(path, call))
    assert places == []


def test_nothing_that_is_read_is_run() -> None:
    places = []
    for path, tree in trees("system", "popen", "shell", *RUNNING):
        for name, call in calls(tree):
            shell = [word for word in call.keywords if word.arg == "shell"]
            if name in RUNNING or name in ("os.system", "os.popen") or shell:
                places.append(f"{where(path, call)} {name}")
    assert places == []


def test_yaml_is_loaded_in_one_place_only() -> None:
    files = {
        path.name
        for path, tree in trees("load", "YAML")
        for name, _ in calls(tree)
        if name in ("yaml.load", "yaml.load_all", "yaml.full_load", "yaml.unsafe_load")
        or name.endswith("YAML")
    }
    assert files == set()  # documents.py drives the safe loader event by event
    loaders = [path.name for path in PRODUCT if "SafeLoader" in path.read_text(encoding="utf-8")]
    assert loaders == ["documents.py"]


def test_nobody_listens_to_a_network() -> None:
    places = [
        where(path, node)
        for path, tree in trees(*NETWORK_FAMILIES)
        if path.name not in NETWORK_ALLOWED
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and node.attr in NETWORK_FAMILIES
    ]
    assert places == []


@pytest.mark.parametrize("unit", ["gyrorigd.service", "gyrorig-nightly.service"])
def test_the_service_may_not_use_one(unit: str) -> None:
    text = (ROOT / "systemd" / "system" / unit).read_text()
    (families,) = [line for line in text.splitlines() if line.startswith("RestrictAddressFam")]
    assert set(families.split("=")[1].split()) <= {"AF_UNIX", "AF_CAN"}
    assert "IPAddressDeny=any" in text
