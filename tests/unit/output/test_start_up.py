"""Commands do not import heavy libraries at start-up, which saves half a second."""

import subprocess
import sys

import pytest

HEAVY = ("matplotlib", "scipy.stats", "scipy.signal", "scipy.ndimage", "scipy.integrate")


@pytest.mark.parametrize("command", ["explain", "solve", "check"])
def test_command_imports_no_heavy_library(command: str) -> None:
    code = (
        f"import sys, gyrorig_solver.commands.{command}_command; "
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert process.stdout.strip() == "[]"
