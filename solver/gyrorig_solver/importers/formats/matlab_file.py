"""MATLAB files (v5 to v7.3) and HDF5 files, with an import map."""

from pathlib import Path

from gyrorig_solver.importers.array_files import array_file_kind
from gyrorig_solver.importers.mapped_format import MappedFormat

_DESCRIPTIONS = {
    "matlab5": "a MATLAB file (v5 to v7)",
    "matlab73": "a MATLAB file (v7.3)",
    "hdf5": "an HDF5 file",
}


def _describe(source: Path) -> str | None:
    return _DESCRIPTIONS.get(array_file_kind(source) or "")


FORMAT = MappedFormat("matlab", "MATLAB file (v5 to v7.3) or HDF5 file", _describe, "tables")
