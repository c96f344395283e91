"""The twin: the properties of a rig that were measured, as a section of the emulated rig's file.

The solver writes the section and the emulator reads it; they share nothing else.

What to use when: `parse_twin` for the section `twin` of a rig file; `twin_to_plain` to write it;
`check_twin` for a section that was converted as a part of a larger document; `find_quantity` for
the value that a name of the posterior means.
"""

from gyrorig_protocol.twin.twin_checks import check_twin, find_quantity, parse_twin, twin_to_plain
from gyrorig_protocol.twin.twin_document import (
    SCHEMA,
    Matrix,
    Posterior,
    Scalar,
    Source,
    Twin,
    TwinBoard,
    TwinCause,
    TwinClock,
    TwinLink,
    TwinRecording,
    TwinTemperature,
    TwinUnit,
    UnitFacts,
    Vector,
)

__all__ = [
    "SCHEMA",
    "Matrix",
    "Posterior",
    "Scalar",
    "Source",
    "Twin",
    "TwinBoard",
    "TwinCause",
    "TwinClock",
    "TwinLink",
    "TwinRecording",
    "TwinTemperature",
    "TwinUnit",
    "UnitFacts",
    "Vector",
    "check_twin",
    "find_quantity",
    "parse_twin",
    "twin_to_plain",
]
