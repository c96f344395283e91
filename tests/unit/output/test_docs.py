"""The documents stay true: links lead somewhere, commands exist as printed, examples run."""

import re
import shlex
import subprocess
import sys
from functools import cache
from pathlib import Path

import click
import numpy as np
import pytest
from tests.support.commands_in_process import run_command

from gyrorig_daemon import cli as gyrorigd_cli
from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_solver import cli as gyrorig_cli
from gyrorig_solver.importers import ImportMap, check_import_map

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
# pages that the site makes of the code
MADE = re.findall(
    r'^ +"([a-z-]+/[a-z-]+\.md)": ', (DOCS / "site_pages.py").read_text(), re.MULTILINE
)
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
MODULES = {"gyrorig": "gyrorig_solver", "gyrorigd": "gyrorig_daemon"}
RUN = {"gyrorig": gyrorig_cli.run, "gyrorigd": gyrorigd_cli.run}


def commands_of(page: Path) -> list[list[str]]:
    text = page.read_text()
    blocks = re.findall(r"^```sh\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines()]
    lines += re.findall(r"`((?:gyrorigd?|make) [^`]*)`", text)
    ours = ("gyrorig", "gyrorigd", "make")
    return [
        shlex.split(line, comments=True)
        for line in lines
        if line.split()[:1] and line.split()[0] in ours
    ]


PRINTED = sorted({tuple(c) for page in PAGES for c in commands_of(page)})


@cache
def help_of(program: str, *command: str) -> str:
    """Return the help of a command; a command that `gyrorig` passes on replaces its process."""
    if program == "gyrorig" and _is_passed_on(command[0]):
        process = subprocess.run(
            [sys.executable, "-m", MODULES[program], *command, "--help"],
            capture_output=True,
            text=True,
            check=False,
        )
    else:
        process = run_command(RUN[program], *command, "--help")
    return process.stdout if process.returncode == 0 else ""


def _is_passed_on(command: str) -> bool:
    click_command = gyrorig_cli.cli.get_command(click.Context(gyrorig_cli.cli), command)
    module = getattr(click_command and click_command.callback, "__module__", "")
    return module.endswith(".daemon_commands")


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text()):
        if not target.startswith(("http://", "https://", "#")):
            path = (page.parent / target.split("#")[0]).resolve()
            made = path.is_relative_to(DOCS) and path.relative_to(DOCS).as_posix() in MADE
            assert made or path.exists(), target


@pytest.mark.parametrize("printed", PRINTED, ids=" ".join)
def test_printed_commands_exist(printed: tuple[str, ...]) -> None:
    if printed[0] == "make":
        makefile = (ROOT / "Makefile").read_text()
        for word in printed[1:]:
            variable, is_set, _ = word.partition("=")
            assert (f"$({variable})" if is_set else f"\n{word}:") in makefile, word
        return
    program, command, *rest = printed
    if command.startswith("-"):
        rest, command = [command, *rest], ""
        text = "--traceback --version --help"
    else:
        text = help_of(program, command)
        if "\nCommands:\n" in text and rest and not rest[0].startswith("-"):  # a group
            command, text = f"{command} {rest[0]}", help_of(program, command, rest.pop(0))
    assert text, f"there is no {program} {command}"
    for word in rest:
        if word.startswith("--"):
            assert word in text, f"{program} {command} has no {word}"
        if word.startswith("config/"):
            assert (ROOT / word).exists(), word


def test_the_example_of_the_conventions_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (ROOT / "docs" / "conventions.md").read_text()
    (example,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    folder = tmp_path / "calibrations" / "GY80-1"
    folder.mkdir(parents=True)
    golden = Path(__file__).parent / "golden" / "good.yaml"
    (folder / "v0001.yaml").write_bytes(golden.read_bytes())
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(example, "conventions.md", "exec"), names)  # noqa: S102 - our own document
    gain, bias, apply = names["gain"], names["bias"], names["true_rate_rad_s"]
    assert isinstance(gain, np.ndarray)
    assert callable(apply)
    rate = np.array([[0.1, -0.2, 0.3], [0.0, 0.0, 0.0]])
    counts = (rate @ gain.T + bias) / 1.5e-4
    np.testing.assert_allclose(apply(counts, 1.5e-4), rate, atol=1e-12)


def test_printed_import_maps_can_be_used() -> None:
    map_count = 0
    for page in PAGES:
        for block in re.findall(r"^```yaml\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL):
            if "schema: gyrorig/import/1" in block:
                check_import_map(
                    convert_document(parse_yaml(block, page.name), ImportMap, page.name), page.name
                )
                map_count += 1
    assert map_count


def test_decisions_are_numbered_and_name_what_was_refused() -> None:
    records = sorted((ROOT / "docs" / "decisions").glob("*.md"))
    assert [int(r.name[:4]) for r in records] == list(range(1, len(records) + 1))
    for record in records:
        text = record.read_text()
        for heading in ("Status:", "## Context", "## Decision", "## Refused", "## Consequences"):
            assert heading in text, f"{record.name}: {heading}"
