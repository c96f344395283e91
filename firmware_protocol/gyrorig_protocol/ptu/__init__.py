"""The pan-tilt unit's ASCII language: bytes and stamps in, events out; no I/O.

What to use when:

- `PtuReplyParser` splits what a port returned into `Reply`, `LimitFlag` and the rest.
- `commands` builds what to send; every command says what answer it expects.
- `read` turns a reply into a value, or a named fault; `require_*` into a value or an error.
- `Dialect`, `offers`, `dialect_from_probe` say what a controller can do.
"""

from gyrorig_protocol.ptu.commands import (
    Expects,
    Power,
    PtuCommand,
    Quantity,
    StepMode,
    assign,
    query,
)
from gyrorig_protocol.ptu.dialect import (
    PROBE,
    Dialect,
    Offers,
    dialect_from_probe,
    dialect_from_version,
    offers,
)
from gyrorig_protocol.ptu.events import (
    Axis,
    Banner,
    CableFlag,
    Echo,
    FrameError,
    FrameReason,
    LimitFlag,
    PtuEvent,
    Reply,
)
from gyrorig_protocol.ptu.parser import PtuReplyParser
from gyrorig_protocol.ptu.refusals import Refusal, RefusalKind, classify_refusal
from gyrorig_protocol.ptu.values import (
    Done,
    Motion,
    PowerState,
    Reading,
    ValueFault,
    Version,
    read,
    require_done,
    require_integer,
    require_motion,
    require_resolution_arcsec,
    require_text,
)

__all__ = [
    "PROBE",
    "Axis",
    "Banner",
    "CableFlag",
    "Dialect",
    "Done",
    "Echo",
    "Expects",
    "FrameError",
    "FrameReason",
    "LimitFlag",
    "Motion",
    "Offers",
    "Power",
    "PowerState",
    "PtuCommand",
    "PtuEvent",
    "PtuReplyParser",
    "Quantity",
    "Reading",
    "Refusal",
    "RefusalKind",
    "Reply",
    "StepMode",
    "ValueFault",
    "Version",
    "assign",
    "classify_refusal",
    "dialect_from_probe",
    "dialect_from_version",
    "offers",
    "query",
    "read",
    "require_done",
    "require_integer",
    "require_motion",
    "require_resolution_arcsec",
    "require_text",
]
