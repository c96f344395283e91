"""No code from the current folder runs: it can be a folder of somebody's recordings."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.unit.security.test_security_sources import PRODUCT, ROOT, dotted_name, trees, where

from gyrorig_protocol.child_process import module_command, protect_children

PLANTED = (
    *("json", "numpy", "signal", "socket", "selectors", "multiprocessing", "click", "msgspec"),
    *("gyrorig_protocol", "gyrorig_daemon", "gyrorig_solver", "encodings", "threading", "struct"),
)
HUB = """
import os
from gyrorig_daemon.links.ports.acquisition_hub import AcquisitionHub
from gyrorig_daemon.links.ports.port_kinds import PortSettings
AcquisitionHub({"port": PortSettings(os.ttyname(os.openpty()[1]), 115200)}).close()
"""
WORKER = """
from gyrorig_solver.fleet.jobs.workers import local_pools
pool, = local_pools(1, 2**31)
pool.job_function = abs
pool.submit(-3)
future, = pool.running_jobs
print(future.result())
pool.discard_executor()
"""
RECOVER = """
import json, subprocess
from gyrorig_protocol.child_process import module_command
subprocess.run(module_command("gyrorig_daemon", "--version"), check=True)
"""


@pytest.fixture
def hostile_folder(tmp_path: Path) -> Path:
    """A folder with modules that say that they were run."""
    folder = tmp_path / "uploads"
    folder.mkdir()
    for name in PLANTED:
        (folder / f"{name}.py").write_text(
            f"open({str(tmp_path / 'PWNED')!r}, 'a').write({name!r} + chr(10))\n"
        )
    return folder


@pytest.mark.parametrize("program", [HUB, WORKER, RECOVER], ids=["hub", "worker", "module"])
def test_children_do_not_import_from_the_current_folder(hostile_folder: Path, program: str) -> None:
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    # -P alone, without PYTHONSAFEPATH: the parent is safe, and its children must be.
    completed = subprocess.run(
        [sys.executable, "-P", "-c", program],
        cwd=hostile_folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    pwned = hostile_folder.parent / "PWNED"
    assert not pwned.exists(), pwned.read_text()
    assert completed.returncode == 0, completed.stderr


def test_every_python_is_started_by_one_function() -> None:
    """Each use of `sys.executable` in the product is that of `module_command`."""
    places = [
        where(path, node)
        for path, tree in trees("executable")
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and dotted_name(node) == "sys.executable"
    ]
    outside = [place for place in places if "child_process.py" not in place]
    assert [place for place in outside if not place.startswith("systemd/")] == []
    assert len(places) > len(outside)


def test_the_installer_starts_python_isolated() -> None:
    text = (ROOT / "systemd" / "install.py").read_text(encoding="utf-8")
    assert text.count('"-I", "-m"') == text.count('"-m"') > 0


def test_programs_protect_their_children(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONSAFEPATH", "")
    protect_children()
    assert os.environ["PYTHONSAFEPATH"] == "1"
    for package in ("gyrorig_daemon", "gyrorig_solver"):
        (entry,) = [path for path in PRODUCT if path.parts[-2:] == (package, "cli.py")]
        assert "protect_children()" in entry.read_text(encoding="utf-8")
    for unit in ("gyrorigd.service", "gyrorig-nightly.service"):
        assert "PYTHONSAFEPATH=1" in (ROOT / "systemd" / "system" / unit).read_text()


LIST_EXTENSIONS = """
import gyrorig_protocol.board_protocols as folder
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.module_registry import find_module
try:
    print(find_module("gyrorig_protocol.board_protocols", [], "board_protocols", "mini"))
except UsageError as fault:
    print(fault)
"""


@pytest.mark.parametrize(
    ("path", "flags", "is_found"),
    [
        (".", ["-P"], False),
        ("", [], False),
        ("/nowhere:", ["-P"], False),
        ("HERE", ["-P"], True),
        ("/nowhere:HERE", ["-P"], True),
    ],
)
def test_extensions_need_a_path_that_names_them(
    tmp_path: Path, path: str, flags: list[str], is_found: bool
) -> None:
    folder = tmp_path / "gyrorig_extensions" / "board_protocols"
    folder.mkdir(parents=True)
    (folder / "mini.py").write_text("")
    (tmp_path / "gyrorig_extensions" / "__init__.py").write_text("print('RUN')")
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    completed = subprocess.run(
        [sys.executable, *flags, "-c", LIST_EXTENSIONS],
        cwd=tmp_path,
        env={**environment, "PYTHONPATH": path.replace("HERE", str(tmp_path))},
        capture_output=True,
        text=True,
        check=True,
    )
    assert ("gyrorig_extensions.board_protocols.mini" in completed.stdout) == is_found
    assert ("RUN" in completed.stdout) == is_found
    assert ("whose code is not run" in completed.stdout) != is_found


def test_the_command_line_of_a_module() -> None:
    assert module_command("a.b", "c") == [sys.executable, "-P", "-m", "a.b", "c"]
