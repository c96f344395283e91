"""Commands start quickly: no heavy library at start-up, and no module is compiled twice."""

import subprocess
import sys

HEAVY = ("matplotlib", "scipy.stats", "scipy.signal", "scipy.ndimage", "scipy.integrate")
COMMANDS = ("explain", "solve", "check")
IMPORT = f"""
import importlib, sys
for command in {COMMANDS!r}:
    importlib.import_module(f"gyrorig_solver.commands.{{command}}_command")
    print(command, [name for name in {HEAVY!r} if name in sys.modules])
"""


def python_output(code: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout


def test_commands_import_no_heavy_library() -> None:
    """It saves half a second."""
    assert python_output(IMPORT).splitlines() == [f"{command} []" for command in COMMANDS]


def test_processes_of_the_tests_write_compiled_modules() -> None:
    """Otherwise each one compiles all modules of the program, which takes half a second."""
    assert python_output("import sys; print(sys.dont_write_bytecode)").strip() == "False"
