"""Measurements made elsewhere, turned into recordings of format 1.

What to use when: `load_import_map`, then `import_measurements`. The map says which column
is what (`mapping`); `columns` reads tables and archives, `streams` and `times` make counts
and stamps of them, `sections` finds rests and known turns, `writing` puts it all into a file.
"""

from gyrorig_solver.importers.mapping import ImportMap, check_import_map, load_import_map
from gyrorig_solver.importers.writing import ImportSummary, import_measurements

__all__ = [
    "ImportMap",
    "ImportSummary",
    "check_import_map",
    "import_measurements",
    "load_import_map",
]
