"""Importers: recordings of format 1 from measurements made elsewhere.

What to use when: `load_import_map` and `import_measurements` for tables and NumPy archives;
`phone_import.import_phone` for a phone's log. An import map (`map_keys`) says which column
is what. `map_columns` reads the files of a map, `import_streams` and `import_times` convert the
columns to counts and times, and `measurement_import` finds rests and known turns and writes
the recording.
"""

from gyrorig_solver.importers.import_map import check_import_map, load_import_map
from gyrorig_solver.importers.imported_recording import ImportSummary
from gyrorig_solver.importers.map_keys import ImportMap
from gyrorig_solver.importers.measurement_import import import_measurements

__all__ = [
    "ImportMap",
    "ImportSummary",
    "check_import_map",
    "import_measurements",
    "load_import_map",
]
