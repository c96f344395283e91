"""Tables of text with an import map (CSV)."""

from pathlib import Path

from gyrorig_protocol.file_kinds import CSV_TABLE, describe_file_kind
from gyrorig_solver.importers.mapped_format import MappedFormat
from gyrorig_solver.importers.measurement_format import read_head


def _describe(source: Path) -> str | None:
    head = read_head(source)
    return CSV_TABLE if head and describe_file_kind(head) == CSV_TABLE else None


FORMAT = MappedFormat("csv", "table (CSV)", _describe)
