"""Reading a file of columns with an import map, for every format of columns.

What to use when: `read_with_map` in the `read` of a format whose columns a map describes.
"""

from pathlib import Path

import msgspec

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.importers.import_map import check_import_map
from gyrorig_solver.importers.import_streams import read_mapped_streams
from gyrorig_solver.importers.map_columns import open_map_columns
from gyrorig_solver.importers.measured_streams import MeasuredStreams
from gyrorig_solver.importers.measurement_format import BOARD_OPTIONS, ImportOptions

MAP_OPTIONS = BOARD_OPTIONS | {"mapping"}


def read_with_map(source: Path, options: ImportOptions) -> MeasuredStreams:
    """Return the streams of a file of columns that the map describes.

    Raises:
        InputError: the file does not agree with the map.
        UsageError: there is no map, or the map contradicts itself.
    """
    if options.mapping is None:
        raise UsageError(
            f"{source.name} needs a column map, because its columns do not specify what they "
            "measure",
            "give a column map with --map. The folder config/imports has examples",
        )
    mapping = options.mapping
    chosen = {"board": options.board, "sensor": options.sensor}
    mapping = msgspec.structs.replace(
        mapping, **{key: value for key, value in chosen.items() if value is not None}
    )
    mapping = check_import_map(mapping, "import map")
    return read_mapped_streams(open_map_columns(source, mapping), mapping, source)
