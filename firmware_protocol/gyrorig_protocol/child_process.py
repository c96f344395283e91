"""How a program of this project starts Python again, without code from the current folder.

`python -m` puts the current folder first on the search path, and `python -c` does too, as in the
servers of `multiprocessing`. A file `json.py` or `numpy.py` among somebody's recordings would then
run. What to use when: `module_command` for each child that is a module; `protect_children` once in
a program, for every Python that starts below it.
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
