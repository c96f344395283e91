"""What is built to be installed: the wheel, the source archive, and what each extra gives.

An extra is tested by the absence of all others: the wheel is laid into an empty folder, and
a process that may import nothing but the wheel and what that extra asks for runs it.
"""

import json
import os
import re
import subprocess
import sys
import tarfile
import zipfile
from email.parser import HeaderParser
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from docs import man
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[3]
# dev and fuzz are for a checkout
EXTRAS = ("", "solver", "fleet", "ros", "tables", "flight", "live", "docs")
SHORT = """
schema: gyrorig/program/1
name: short
description: 2 s at rest
steps:
  - rest: {seconds: 2.0, phase: static}
"""
# Refuses to import whatever is installed here and was not asked for.
RUNNER = """
import json, sys
allowed, folder, program, *arguments = json.loads(sys.argv[1])
allowed = set(allowed) | set(sys.stdlib_module_names)
class Allowed:
    def __init__(self, finder):
        self.finder = finder
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top in allowed or top.startswith("_sysconfigdata"):  # Python's own
            return self.finder.find_spec(name, path, target)
    def __getattr__(self, name):
        return getattr(self.finder, name)
sys.meta_path[:] = map(Allowed, sys.meta_path)
sys.path.insert(0, folder)
sys.argv = [program, *arguments]
if program == "python":
    exec(arguments[0])
    sys.exit()
module = {"gyrorig": "gyrorig_solver.cli", "gyrorigd": "gyrorig_daemon.cli"}[program]
__import__(module)
sys.modules[module].main()
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the wheel and the source archive."""
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-d", folder],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    return folder


@pytest.fixture(scope="module")
def installed(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, laid out as `pip install --target` does it."""
    folder = tmp_path_factory.mktemp("target")
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        for name in archive.namelist():
            place = re.sub(r"^gyrorig-[^/]*\.data/data/", "", name)
            path = folder / place
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(archive.read(name))
    return folder


def modules_of(extra: str) -> set[str]:
    """Names that can be imported when gyrorig is installed with one extra, or with none."""
    waiting = [("gyrorig", frozenset({extra} - {""}))]
    visited: set[tuple[str, frozenset[str]]] = set()
    modules = {"gyrorig_protocol", "gyrorig_daemon", "gyrorig_solver"}
    while waiting:
        name, extras = waiting.pop()
        if (name, extras) in visited:
            continue
        visited.add((name, extras))
        package = distribution(name)
        for text in package.requires or []:
            asked = Requirement(text)
            marker = asked.marker
            if marker is None or any(marker.evaluate({"extra": e}) for e in (*extras, "")):
                waiting.append((asked.name, frozenset(asked.extras)))
        if canonicalize_name(name) != "gyrorig":
            modules |= {path.parts[0].split(".")[0] for path in package.files or [] if path.parts}
    return modules


def run(installed: Path, extra: str, *line: str) -> subprocess.CompletedProcess[str]:
    try:
        allowed = sorted(modules_of(extra))
    except PackageNotFoundError as missing:
        pytest.skip(f"{missing} is not installed here: it comes with `make test`")
    return subprocess.run(
        [sys.executable, "-c", RUNNER, json.dumps([allowed, str(installed), *line])],
        capture_output=True, text=True, check=False, cwd=installed.parent,
        env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"},
    )  # fmt: skip


def test_the_wheel_holds_what_is_needed_without_a_checkout(installed: Path) -> None:
    for name in (
        "gyrorig_solver/cli.py",
        "gyrorig_solver/report/page.html.j2",
        "gyrorig_solver/fleet/page/web/index.html",
        "gyrorig_protocol/py.typed",
        "share/gyrorig/config/rig.yaml",
        "share/gyrorig/config/boards/L3G4200D.yaml",
        "share/gyrorig/config/imports/broad.yaml",
        "share/man/man1/gyrorig.1",
        "share/bash-completion/completions/gyrorigd",
        "share/zsh/site-functions/_gyrorig",
        "share/fish/vendor_completions.d/gyrorig.fish",
    ):
        assert (installed / name).is_file(), name
    (meta,) = installed.glob("gyrorig-*.dist-info")
    metadata = HeaderParser().parsestr((meta / "METADATA").read_text())
    assert metadata["License-Expression"] == "MIT"
    assert "LICENSE" in str(metadata["License-File"])
    assert "gyrorigd = gyrorig_daemon.cli:main" in (meta / "entry_points.txt").read_text()


def test_the_source_archive_builds_and_tests(built: Path) -> None:
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as held:
        names = {name.partition("/")[2] for name in held.getnames()}
    for name in ("pyproject.toml", "constraints.txt", "Makefile", "LICENSE", "CITATION.cff"):
        assert name in names
    assert "tests/unit/packaging/test_wheel.py" in names
    assert not [name for name in names if name.endswith((".mcap", ".pyc"))]


@pytest.mark.parametrize("extra", EXTRAS)
def test_each_extra_alone_says_its_version(installed: Path, extra: str) -> None:
    result = run(installed, extra, "gyrorig", "--version")
    assert result.returncode == 0, result.stderr
    assert re.fullmatch(r"gyrorig \d+\.\d+\.\d+\S*\n", result.stdout)


def test_the_daemon_needs_no_extra(installed: Path, tmp_path: Path) -> None:
    out = tmp_path / "recordings"
    config = installed / "share" / "gyrorig" / "config"
    program = tmp_path / "short.yaml"
    program.write_text(SHORT)
    result = run(
        installed, "", "gyrorigd", "record", "--simulated-time", "--config",
        str(config / "rig.yaml"), "--program", str(program), "--out", str(out), "--json",
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert Path(json.loads(result.stdout)["recording"]).stat().st_size > 10_000


def test_what_an_extra_would_bring_is_named(installed: Path, tmp_path: Path) -> None:
    bag = tmp_path / "log.bag"
    bag.write_bytes(b"#ROSBAG V2.0\n")
    for extra, line, wanted in (
        ("solver", ("import", str(bag)), "pip install 'gyrorig[ros]'"),
        ("", ("solve", "x.mcap"), "pip install 'gyrorig[solver]'"),
        ("solver", ("fleet", "store"), "pip install 'gyrorig[fleet]'"),
    ):
        result = run(installed, extra, "gyrorig", *line)
        assert result.returncode == 2
        assert result.stderr.count("\n") == 1
        assert wanted in result.stderr


def test_live_alone_makes_a_live_view(installed: Path) -> None:
    code = (
        "from gyrorig_daemon.live.foxglove_view import open_live_view\n"
        "view = open_live_view('127.0.0.1:0', print)\n"
        "view.show_status({'state': 'ready'})\n"
        "view.close()\n"
    )
    result = run(installed, "live", "python", code)
    assert result.returncode == 0, result.stderr
    assert re.fullmatch(r"Live view at ws://127\.0\.0\.1:\d+\n", result.stdout)
    without = run(installed, "", "python", code)
    assert without.returncode == 1
    assert "pip install 'gyrorig[live]'" in without.stderr


@pytest.mark.long
def test_fleet_alone_takes_recordings_through_a_batch(installed: Path, tmp_path: Path) -> None:
    """`fleet` brings `solver`: what a batch does is solving."""
    code = "import duckdb, s3fs, cryptography, distributed; print(duckdb.sql('SELECT 42'))"
    result = run(installed, "fleet", "python", code)
    assert result.returncode == 0, result.stderr
    assert "42" in result.stdout
    config = installed / "share" / "gyrorig" / "config"
    recordings, store = tmp_path / "recordings", str(tmp_path / "store")
    program = tmp_path / "short.yaml"
    program.write_text(SHORT)
    for line in (
        ("gyrorigd", "record", "--simulated-time", "--config", str(config / "rig.yaml"),
         "--program", str(program), "--out", str(recordings)),
        ("gyrorig", "batch", "--spool", str(recordings), "--store", store, "--workers", "1"),
        ("gyrorig", "store", "ls", store),
        ("gyrorig", "store", "verify", store),
    ):  # fmt: skip
        result = run(installed, "fleet", *line)
        assert result.returncode == 0, result.stderr
    assert len(list((tmp_path / "store").rglob("v0001.yaml"))) == 1


def test_docs_alone_can_make_a_site(installed: Path, tmp_path: Path) -> None:
    """A site of anything: this project's own is made in a checkout."""
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text("# One page\n")
    (tmp_path / "mkdocs.yml").write_text("site_name: one\ntheme: material\n")
    code = (
        "import os; os.environ['NO_MKDOCS_2_WARNING'] = '1'\n"
        "from mkdocs.commands.build import build\n"
        "from mkdocs.config import load_config\n"
        f"build(load_config({str(tmp_path / 'mkdocs.yml')!r}))\n"
    )
    result = run(installed, "docs", "python", code)
    assert result.returncode == 0, result.stderr
    assert "One page" in (tmp_path / "site" / "index.html").read_text()


@pytest.mark.parametrize(
    ("program", "words", "wanted"),
    [
        ("gyrorig", ["so"], ["solve"]),
        ("gyrorig", ["store", "ver"], ["verify"]),
        ("gyrorig", ["solve", "--meth"], ["--method"]),
        ("gyrorigd", ["sta"], ["status"]),
    ],
)
def test_a_shell_completes(
    installed: Path, program: str, words: list[str], wanted: list[str]
) -> None:
    """What the wheel brings for bash, in bash, against the installed command."""
    script = installed / "share" / "bash-completion" / "completions" / program
    line = " ".join([program, *words])
    asks = (
        f"source {script}; COMP_WORDS=({line}); COMP_CWORD={len(words)}; "
        f'_{program}_completion {program}; printf "%s\\n" "${{COMPREPLY[@]}}"'
    )
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    process = subprocess.run(
        ["bash", "-c", asks], capture_output=True, text=True, check=False,
        env={**os.environ, "PATH": path},
    )  # fmt: skip
    assert process.stdout.split() == wanted, process.stderr


@pytest.mark.parametrize("program", sorted(man.SUMMARIES))
def test_the_manual_is_of_todays_commands(program: str) -> None:
    page = (man.PAGES / f"{program}.1").read_text(encoding="utf-8")
    assert page == man.make_page(program), "run `make docs` to write the page again"


def test_the_solver_alone_imports_a_recording_with_the_wheels_own_map(
    installed: Path, tmp_path: Path
) -> None:
    result = run(
        installed, "solver", "gyrorig", "import", "nonesuch", "x.csv",
        "--out", str(tmp_path / "x.mcap"),
    )  # fmt: skip
    assert result.returncode == 2
    assert "broad" in result.stderr  # the maps that came with the wheel are listed
