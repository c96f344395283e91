"""All fuzz targets by name, and the inputs that once failed.

What to use when: put the input of a failure into `found/TARGET/`; from then on `make test` runs it.
"""

from pathlib import Path

from tests.fuzz import (
    can_targets,
    document_targets,
    file_targets,
    import_targets,
    link_targets,
    service_targets,
)

TARGETS = {
    target.name: target
    for module in (
        link_targets,
        can_targets,
        document_targets,
        file_targets,
        import_targets,
        service_targets,
    )
    for target in module.TARGETS
}
FOUND = Path(__file__).with_name("found")


def crash_inputs(name: str) -> list[bytes]:
    """Return the inputs with which this target once failed."""
    return [path.read_bytes() for path in sorted((FOUND / name).glob("*"))]
