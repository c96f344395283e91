"""All targets by name, and what has once broken one of them.

What to use when: a crash's input is put into `found/TARGET/`, and is tried by `make test`
from then on.
"""

from pathlib import Path

from tests.fuzz import (
    can_targets,
    document_targets,
    file_targets,
    link_targets,
    service_targets,
)

TARGETS = {
    target.name: target
    for module in (link_targets, can_targets, document_targets, file_targets, service_targets)
    for target in module.TARGETS
}
FOUND = Path(__file__).with_name("found")


def found_inputs(name: str) -> list[bytes]:
    """Return the inputs that once broke this target."""
    return [path.read_bytes() for path in sorted((FOUND / name).glob("*"))]
