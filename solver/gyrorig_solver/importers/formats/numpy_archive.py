"""NumPy archives with an import map (npz)."""

import zipfile
from pathlib import Path

from gyrorig_protocol.file_kinds import NUMPY_ARCHIVE
from gyrorig_solver.importers.mapped_format import MappedFormat
from gyrorig_solver.importers.measurement_format import read_head


def _describe(source: Path) -> str | None:
    if not read_head(source).startswith(b"PK"):
        return None
    try:
        with zipfile.ZipFile(source) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, NotImplementedError):
        return None
    return NUMPY_ARCHIVE if names and all(name.endswith(".npy") for name in names) else None


FORMAT = MappedFormat("npz", "NumPy archive (npz)", _describe)
