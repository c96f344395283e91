"""Parquet files with an import map."""

from pathlib import Path

from gyrorig_solver.importers.array_files import array_file_kind
from gyrorig_solver.importers.mapped_format import MappedFormat


def _describe(source: Path) -> str | None:
    return "a Parquet file" if array_file_kind(source) == "parquet" else None


FORMAT = MappedFormat("parquet", "Parquet file", _describe, "tables")
