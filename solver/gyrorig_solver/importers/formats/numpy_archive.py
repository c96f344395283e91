"""NumPy archives with an import map (npz)."""

import zipfile
from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.file_kinds import NUMPY_ARCHIVE
from gyrorig_solver.importers.mapped_format import MAP_OPTIONS, read_with_map
from gyrorig_solver.importers.measured_streams import MeasuredStreams
from gyrorig_solver.importers.measurement_format import FormatMatch, ImportOptions, read_head


@dataclass(frozen=True, slots=True)
class NumpyArchive:
    """Arrays in a NumPy archive; an import map says what they are."""

    name: str = "npz"
    title: str = "NumPy archive (npz)"
    extra: str = ""
    used_options: frozenset[str] = MAP_OPTIONS

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for a zip of .npy files."""
        if not read_head(source).startswith(b"PK"):
            return None
        try:
            with zipfile.ZipFile(source) as archive:
                names = archive.namelist()
        except (zipfile.BadZipFile, NotImplementedError):
            return None
        is_arrays = bool(names) and all(name.endswith(".npy") for name in names)
        return FormatMatch(NUMPY_ARCHIVE, is_complete=False) if is_arrays else None

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return the streams that the map describes."""
        return read_with_map(source, options)


FORMAT = NumpyArchive()
