"""How a program of this project starts Python again, and where the output of a program goes.

`python -m` puts the current folder first on the search path, and `python -c` does too, as in the
servers of `multiprocessing`. A file `json.py` or `numpy.py` among somebody's recordings would then
run. What to use when: `module_command` for each child that is a module; `protect_children` once in
a program, for every Python that starts below it; `open_closed_streams` once in a program;
`discard_output` if the output cannot be written.
"""

import os
import sys


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs a module with this interpreter.

    The current folder is not on the search path of the child (option -P).
    """
    return [sys.executable, "-P", "-m", module, *arguments]


def protect_children() -> None:
    """Keep the current folder off the search path of each Python that starts from now on.

    Source: the variable PYTHONSAFEPATH of Python 3.11.
    """
    os.environ["PYTHONSAFEPATH"] = "1"


def open_closed_streams() -> None:
    """Open the null device as each standard stream that the parent process closed.

    Python sets such a stream to None. The next file that is opened would get its number, and each
    output to the stream would go into this file.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode, encoding="utf-8"))


def discard_output() -> None:
    """Send what standard output still holds to the null device, so that the exit cannot fail."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
