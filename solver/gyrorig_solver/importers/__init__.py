"""Importers: recordings of format 1 from measurements made elsewhere.

What to use when: `import_files` for files of any format; `import_measurements` with
`load_import_map` for one table or archive and its import map. Each format of the folder `formats`
reads `MeasuredStreams`, which are neutral; `imported_recording` writes them. An import map
(`map_keys`) says which column is what.
"""

from gyrorig_solver.importers.import_map import check_import_map, load_import_map
from gyrorig_solver.importers.imported_recording import ImportSummary
from gyrorig_solver.importers.map_keys import ImportMap
from gyrorig_solver.importers.mapped_format import MissingMapError
from gyrorig_solver.importers.measurement_format import ImportOptions, find_format, formats
from gyrorig_solver.importers.measurement_import import import_files, import_measurements

__all__ = [
    "ImportMap",
    "ImportOptions",
    "ImportSummary",
    "MissingMapError",
    "check_import_map",
    "find_format",
    "formats",
    "import_files",
    "import_measurements",
    "load_import_map",
]
