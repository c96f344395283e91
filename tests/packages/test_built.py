"""The wheel and the source archive: correct for an index, and installed by pipx, uv and pip.

Needs a package index: `make test-packages`.
"""

import hashlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CONSTRAINTS = ROOT / "constraints.txt"
BIN = Path(sys.executable).parent

pytestmark = [pytest.mark.packages, pytest.mark.timeout(900)]


def run(*command: str | Path, **environment: str) -> str:
    """Run a program that must succeed, outside of the checkout; return its output."""
    with tempfile.TemporaryDirectory() as folder:
        process = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, check=False,
            env={**os.environ, **environment},
        )  # fmt: skip
    assert process.returncode == 0, process.stdout + process.stderr
    return process.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the wheel and the source archive."""
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-d", folder],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    return folder


def wheel(built: Path) -> str:
    """The requirement of the wheel with its digest, which pip wants beside hashed constraints."""
    (path,) = built.glob("*.whl")
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    return f"gyrorig[solver] @ {path.as_uri()}#sha256={sha256}"


def use(programs: Path) -> None:
    """Record and solve with installed programs."""
    config = next(programs.parents[0].glob("share/gyrorig/config"))
    with tempfile.TemporaryDirectory() as name:
        run(
            programs / "gyrorigd", "record", "--simulated-time", "--config", config / "rig.yaml",
            "--program", config / "programs" / "survey-40.yaml", "--out", name,
        )  # fmt: skip
        (recording,) = Path(name).glob("*.mcap")
        run(programs / "gyrorig", "solve", recording, "--extend", "none", "--out", name)
        assert list(Path(name).rglob("v0001.yaml"))


def test_the_index_would_take_them(built: Path) -> None:
    output = run(BIN / "twine", "check", "--strict", *sorted(built.iterdir()))
    assert output.count("PASSED") == 2


def test_pipx_installs_the_wheel(built: Path, tmp_path: Path) -> None:
    run(
        BIN / "pipx", "install", "--python", sys.executable, wheel(built),
        "--pip-args", f"--constraint={CONSTRAINTS} --only-binary=:all:",
        PIPX_HOME=str(tmp_path / "home"), PIPX_BIN_DIR=str(tmp_path / "bin"),
        PIPX_MAN_DIR=str(tmp_path / "man"),
    )  # fmt: skip
    assert (tmp_path / "man" / "man1" / "gyrorig.1").exists()
    use((tmp_path / "bin" / "gyrorig").resolve().parent)


def test_uv_installs_the_wheel_as_a_tool(built: Path, tmp_path: Path) -> None:
    run(
        BIN / "uv", "tool", "install", "--python", sys.executable, "--no-build",
        "--constraints", CONSTRAINTS, wheel(built),
        UV_TOOL_DIR=str(tmp_path / "tools"), UV_TOOL_BIN_DIR=str(tmp_path / "bin"),
    )  # fmt: skip
    use((tmp_path / "bin" / "gyrorig").resolve().parent)


def test_pip_builds_the_source_archive(built: Path, tmp_path: Path) -> None:
    (archive,) = built.glob("*.tar.gz")
    run(sys.executable, "-m", "venv", "--without-pip", tmp_path / "venv")
    run(
        sys.executable, "-m", "pip", "--python", tmp_path / "venv", "install", "-q",
        "--build-constraint", CONSTRAINTS, "--no-deps", archive,
    )  # fmt: skip
    assert (tmp_path / "venv" / "bin" / "gyrorigd").is_file()


def test_the_digests_are_those_of_the_index() -> None:
    run(sys.executable, ROOT / "release" / "lock.py", "--check")
