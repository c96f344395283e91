"""Where the files that ship with the project are: configurations, programs, maps, data sheets.

What to use when: `config_folders`, in the order in which they are asked. A file of the
working directory wins over the checkout's, and that over the one that a wheel installed.
"""

from collections.abc import Iterator
from pathlib import Path

_HERE = Path(__file__).resolve()
_CHECKOUT = _HERE.parents[2]
# of a wheel: PREFIX/share/gyrorig, PREFIX/lib/python3.x/site-packages/gyrorig_solver being here;
# with `pip install --target DIR` it is DIR/share/gyrorig
_PREFIXES = tuple(_HERE.parents)[1:6]


def config_folders() -> Iterator[Path]:
    """Yield the folders `config` that there may be."""
    yield Path.cwd() / "config"
    yield _CHECKOUT / "config"
    for prefix in _PREFIXES:
        yield prefix / "share" / "gyrorig" / "config"
