"""Names in a rig's document that have to be different."""

from collections.abc import Iterable


def first_twice(names: Iterable[str]) -> str | None:
    """Return the first name that has come before, None where each is alone."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None
