"""Folders of the files that ship with the project: configurations, programs, maps, data sheets.

What to use when: `config_folders`, in the order in which they are searched. A file in the working
directory has priority over the checkout's, and that over one that a wheel installed.
"""

from collections.abc import Iterator
from pathlib import Path

_THIS_FILE = Path(__file__).resolve()
_CHECKOUT = _THIS_FILE.parents[3]
# A wheel installs PREFIX/share/gyrorig and PREFIX/lib/python3.x/site-packages/gyrorig_solver;
# with `pip install --target DIR` the folder is DIR/share/gyrorig.
_PREFIXES = tuple(_THIS_FILE.parents)[2:7]


def config_folders() -> Iterator[Path]:
    """Yield the possible `config` folders, whether they exist or not."""
    yield Path.cwd() / "config"
    yield _CHECKOUT / "config"
    for prefix in _PREFIXES:
        yield prefix / "share" / "gyrorig" / "config"
