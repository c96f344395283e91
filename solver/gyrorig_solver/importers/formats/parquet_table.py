"""Parquet files with an import map."""

from dataclasses import dataclass
from pathlib import Path

from gyrorig_solver.importers.array_files import array_file_kind
from gyrorig_solver.importers.mapped_format import MAP_OPTIONS, read_with_map
from gyrorig_solver.importers.measured_streams import MeasuredStreams
from gyrorig_solver.importers.measurement_format import FormatMatch, ImportOptions


@dataclass(frozen=True, slots=True)
class ParquetTable:
    """Columns of a Parquet file; an import map says what they are."""

    name: str = "parquet"
    title: str = "Parquet file"
    extra: str = "tables"
    used_options: frozenset[str] = MAP_OPTIONS

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for the signature of Parquet."""
        if array_file_kind(source) != "parquet":
            return None
        return FormatMatch("a Parquet file", is_complete=False)

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return the streams that the map describes."""
        return read_with_map(source, options)


FORMAT = ParquetTable()
