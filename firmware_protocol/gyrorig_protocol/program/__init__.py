"""Motion programs: the motion of the pan-tilt unit as a YAML document, in degrees.

The daemon executes a program; the solver's planner writes one.

What to use when: `parse_program` for a document; `unroll_steps` for its steps in order, with
repeats expanded; `unroll_manual_steps` for a program that a person executes.
"""

from gyrorig_protocol.program.program_document import (
    Home,
    MotionProgram,
    Move,
    PtuSettings,
    Repeat,
    Rest,
    Step,
    Turn,
    parse_program,
    unroll_manual_steps,
    unroll_steps,
)

__all__ = [
    "Home",
    "MotionProgram",
    "Move",
    "PtuSettings",
    "Repeat",
    "Rest",
    "Step",
    "Turn",
    "parse_program",
    "unroll_manual_steps",
    "unroll_steps",
]
