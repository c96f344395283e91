"""Every command's help shows its example on a line of its own."""

import re

import pytest
from click.testing import CliRunner

from gyrorig_solver.cli import cli
from gyrorig_solver.commands.terminal import Terminal


@pytest.mark.parametrize("command", ["check", "demo", "explain", "import", "plan", "solve"])
def test_the_example_is_a_line(command: str) -> None:
    shown = CliRunner().invoke(cli, [command, "--help"], obj=Terminal()).output
    assert "\\b" not in shown
    assert re.search(rf"^ +gyrorig {command} ", shown, re.MULTILINE)
