"""MATLAB files (v5 to v7.3) and HDF5 files, with an import map."""

from dataclasses import dataclass
from pathlib import Path

from gyrorig_solver.importers.array_files import array_file_kind
from gyrorig_solver.importers.mapped_format import MAP_OPTIONS, read_with_map
from gyrorig_solver.importers.measured_streams import MeasuredStreams
from gyrorig_solver.importers.measurement_format import FormatMatch, ImportOptions

_DESCRIPTIONS = {
    "matlab5": "a MATLAB file (v5 to v7)",
    "matlab73": "a MATLAB file (v7.3)",
    "hdf5": "an HDF5 file",
}


@dataclass(frozen=True, slots=True)
class MatlabFile:
    """Variables of a MATLAB or HDF5 file; an import map says what they are."""

    name: str = "matlab"
    title: str = "MATLAB file (v5 to v7.3) or HDF5 file"
    extra: str = "tables"
    used_options: frozenset[str] = MAP_OPTIONS

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for the header of MATLAB or the signature of HDF5."""
        kind = array_file_kind(source)
        if kind not in _DESCRIPTIONS:
            return None
        return FormatMatch(_DESCRIPTIONS[kind], is_complete=False)

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return the streams that the map describes."""
        return read_with_map(source, options)


FORMAT = MatlabFile()
