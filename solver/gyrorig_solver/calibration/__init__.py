"""Calibration documents: building, reading and storing them, and their texts.

What to use when: `calibration_builder.build_calibration` for the document of a fit;
`calibration_document.parse_calibration` to read one; `calibration_store` for versions on disk;
`verdict` for the verdict; `calibration_wording` and `calibration_summary` for texts;
`paper_calibration` for the paper's method. `pipeline.solve_board` does all of it for a recording.

It exports the names that need numpy alone, because `apply` reads a document without scipy. Import
the others from their modules.
"""

from gyrorig_solver.calibration.calibration_document import (
    CalibrationDocument,
    Parameter,
    UnitPriorRecord,
    calibration_as_mapping,
    parse_calibration,
)
from gyrorig_solver.calibration.calibration_store import (
    STORE_FILE,
    VERSION_FILE,
    CalibrationStore,
    StoredVersion,
    create_store,
)
from gyrorig_solver.calibration.document_checks import cause_of_parameter
from gyrorig_solver.calibration.sensor_profiles import find_profile
from gyrorig_solver.calibration.temperature_record import (
    TemperatureRecord,
    bias_curve,
    scale_curve,
)

__all__ = [
    "STORE_FILE",
    "VERSION_FILE",
    "CalibrationDocument",
    "CalibrationStore",
    "Parameter",
    "StoredVersion",
    "TemperatureRecord",
    "UnitPriorRecord",
    "bias_curve",
    "calibration_as_mapping",
    "cause_of_parameter",
    "create_store",
    "find_profile",
    "parse_calibration",
    "scale_curve",
]
