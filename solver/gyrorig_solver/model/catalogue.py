"""The catalogue of physical causes, by id.

The catalogue contains every module of `model.causes` that has a `TERM`: a new cause is a new file.

What to use when: `catalogue` for all causes; `find_term` for a cause that a user has named;
`term_of_law` for the cause of a quantity of the motion law; `cause_display_unit` for the unit of a
size.
"""

import importlib
import pkgutil
from functools import cache
from types import MappingProxyType

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.suggestions import did_you_mean
from gyrorig_solver.model import causes
from gyrorig_solver.model.parameter_units import MIN_PERCENT_RATIO, display_unit
from gyrorig_solver.model.term import Term


@cache
def catalogue() -> MappingProxyType[str, Term]:
    """Return every cause by its id, in alphabetical order."""
    terms_by_id: dict[str, Term] = {}
    for module in pkgutil.iter_modules(causes.__path__):
        candidate: Term | None = getattr(
            importlib.import_module(f"{causes.__name__}.{module.name}"), "TERM", None
        )
        if candidate is not None:
            terms_by_id[candidate.cause] = candidate
    return MappingProxyType(dict(sorted(terms_by_id.items())))


def term_of_law(quantity: str) -> Term:
    """Return the cause whose values are a `LawQuantity`, for example "acceleration"."""
    return next(term for term in catalogue().values() if term.law_quantity == quantity)


def cause_display_unit(cause: str, parameter: str, unit: str) -> tuple[float, str]:
    """Return the factor from a parameter's SI unit to the displayed unit, and that unit.

    Args:
        cause: an id; a finding can have one that is not in the catalogue.
        parameter: its name; "" for the first parameter in that unit.
        unit: the SI unit.
    """
    parameters = catalogue()[cause].parameters if cause in catalogue() else ()
    typical_sizes = (
        p.typical_size for p in parameters if p.unit == unit and parameter in ("", p.name)
    )
    return display_unit(unit, next(typical_sizes, MIN_PERCENT_RATIO))


def cause_equation(cause: str) -> str:
    """Return the equation of a cause; empty for an id that is not in the catalogue."""
    term = catalogue().get(cause)
    return "" if term is None else term.equation


def find_term(cause: str) -> Term:
    """Return the cause with an id.

    Raises:
        UsageError: the catalogue has no such id. The error suggests at most three ids.
    """
    if cause not in catalogue():
        suggestion = did_you_mean(cause[:40], catalogue())
        list_all = "`gyrorigd causes` lists all causes"
        raise UsageError(
            f"{cause[:40]!r} is not the name of a known cause of errors",
            f"{suggestion} {list_all}".strip(),
        )
    return catalogue()[cause]
