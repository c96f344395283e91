"""The commands called in the process of the test, without the start of another interpreter.

What to use when: `run_command` where a test judges what a command computes and prints; a process
where a test judges signals, exit by a signal, the environment or the installed program.
"""

import contextlib
import io
import subprocess
from collections.abc import Callable, Sequence


def run_command(
    run: Callable[[Sequence[str]], int], *arguments: str
) -> subprocess.CompletedProcess[str]:
    """Call a command line interface; return its exit status and its output as text."""
    output, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
        code = run(arguments)
    return subprocess.CompletedProcess(arguments, code, output.getvalue(), errors.getvalue())
