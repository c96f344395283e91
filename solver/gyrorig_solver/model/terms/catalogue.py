"""All causes, found by their ids.

Every module of this package that has a `TERM` takes part: adding a cause is adding a file.
"""

import difflib
import importlib
import pkgutil
from functools import cache
from types import MappingProxyType

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.model import terms
from gyrorig_solver.model.terms.protocol import Term


@cache
def catalogue() -> MappingProxyType[str, Term]:
    """Return every cause by its id, in the order of ids."""
    found: dict[str, Term] = {}
    for module in pkgutil.iter_modules(terms.__path__):
        term: Term | None = getattr(
            importlib.import_module(f"{terms.__name__}.{module.name}"), "TERM", None
        )
        if term is not None:
            found[term.cause] = term
    return MappingProxyType(dict(sorted(found.items())))


def term(cause: str) -> Term:
    """Return one cause.

    Raises:
        UsageError: there is none of that id.
    """
    if cause not in catalogue():
        near = difflib.get_close_matches(cause, catalogue(), 1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise UsageError(
            f"no cause is called {cause[:40]!r}", f"{hint}there are {', '.join(catalogue())}"
        )
    return catalogue()[cause]
