"""What a command loads before it begins: half a second is saved by what is left out."""

import subprocess
import sys

import pytest

HEAVY = ("matplotlib", "scipy.stats", "scipy.signal", "scipy.ndimage", "scipy.integrate")


@pytest.mark.parametrize("command", ["explain", "solve", "check"])
def test_a_command_loads_nothing_heavy(command: str) -> None:
    code = (
        f"import sys, gyrorig_solver.commands.{command}; "
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
