"""Motion programs as data: what the unit shall do, in degrees, as a person writes it.

A program is a YAML document. The daemon carries it out; the solver's planner writes it.
"""

from gyrorig_protocol.program.document import (
    Home,
    MotionProgram,
    Move,
    Repeat,
    Rest,
    Step,
    UnitSettings,
    parse_program,
    unrolled,
)

__all__ = [
    "Home",
    "MotionProgram",
    "Move",
    "Repeat",
    "Rest",
    "Step",
    "UnitSettings",
    "parse_program",
    "unrolled",
]
