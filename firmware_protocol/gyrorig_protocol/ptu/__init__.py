"""The ASCII protocol of the pan-tilt unit (PTU), without input or output (sans-IO).

What to use when:

- `PtuReplyParser` parses received bytes into `Reply`, `LimitFlag` and other events.
- `ptu_commands` has the commands; every command has the kind of its answer.
- `read_value` reads a reply as a value or a fault; `require_*` return the value or raise an error.
- `MotionTranslator` turns commands into neutral orders of motion.
- `Dialect`, `dialect_features`, `dialect_from_probe` describe what a controller supports.
"""

from gyrorig_protocol.ptu.dialect import (
    PROBE,
    Dialect,
    DialectFeatures,
    dialect_features,
    dialect_from_probe,
    dialect_from_version,
)
from gyrorig_protocol.ptu.motion_translation import MotionTranslator
from gyrorig_protocol.ptu.ptu_commands import (
    AnswerKind,
    PtuCommand,
    Quantity,
    assign_quantity,
    query_quantity,
)
from gyrorig_protocol.ptu.ptu_events import (
    Axis,
    Banner,
    CableFlag,
    Echo,
    InvalidLine,
    InvalidLineReason,
    LimitFlag,
    PtuEvent,
    Reply,
)
from gyrorig_protocol.ptu.refusals import Refusal, RefusalKind, classify_refusal
from gyrorig_protocol.ptu.reply_parser import PtuReplyParser
from gyrorig_protocol.ptu.reply_values import (
    Acknowledgement,
    FirmwareVersion,
    MotionReading,
    PowerReading,
    Reading,
    ValueFault,
    read_value,
    require_done,
    require_integer,
    require_resolution_arcsec,
)

__all__ = [
    "PROBE",
    "Acknowledgement",
    "AnswerKind",
    "Axis",
    "Banner",
    "CableFlag",
    "Dialect",
    "DialectFeatures",
    "Echo",
    "FirmwareVersion",
    "InvalidLine",
    "InvalidLineReason",
    "LimitFlag",
    "MotionReading",
    "MotionTranslator",
    "PowerReading",
    "PtuCommand",
    "PtuEvent",
    "PtuReplyParser",
    "Quantity",
    "Reading",
    "Refusal",
    "RefusalKind",
    "Reply",
    "ValueFault",
    "assign_quantity",
    "classify_refusal",
    "dialect_features",
    "dialect_from_probe",
    "dialect_from_version",
    "query_quantity",
    "read_value",
    "require_done",
    "require_integer",
    "require_resolution_arcsec",
]
