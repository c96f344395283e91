"""Tables of text with an import map (CSV)."""

from dataclasses import dataclass
from pathlib import Path

from gyrorig_protocol.file_kinds import CSV_TABLE, describe_file_kind
from gyrorig_solver.importers.mapped_format import MAP_OPTIONS, read_with_map
from gyrorig_solver.importers.measured_streams import MeasuredStreams
from gyrorig_solver.importers.measurement_format import FormatMatch, ImportOptions, read_head


@dataclass(frozen=True, slots=True)
class CsvTable:
    """A table of text; an import map says what its columns are."""

    name: str = "csv"
    title: str = "table (CSV)"
    extra: str = ""
    used_options: frozenset[str] = MAP_OPTIONS

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for text with columns."""
        head = read_head(source)
        if head and describe_file_kind(head) == CSV_TABLE:
            return FormatMatch(CSV_TABLE, is_complete=False)
        return None

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return the streams that the map describes."""
        return read_with_map(source, options)


FORMAT = CsvTable()
