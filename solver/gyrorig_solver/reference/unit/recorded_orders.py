"""The orders of a recording: neutral messages, or the commands of a recording without them.

What to use when: `read_orders` for a recording; `translate_exchanges` for commands of a Directed
Perception unit in text. All later modules use only neutral orders.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from gyrorig_protocol.motion_orders import AxisOrder, OrderAxis, OrderKind
from gyrorig_protocol.ptu import MotionTranslator
from gyrorig_protocol.recording.messages import CommandCode
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.reference.unit.unit_moves import UnitOrder

_KINDS = {int(kind): kind for kind in OrderKind}
_AXES = {int(axis): axis for axis in OrderAxis}


@dataclass(frozen=True, slots=True)
class UnitExchange:
    """One command in text and its reply, times in s on the capture clock."""

    request_s: float  # transmission of its last byte
    reply_s: float
    ok: bool
    command: str


def read_orders(recording: Recording, byte_s: float, origin_ns: int) -> list[UnitOrder]:
    """Return the orders of a recording, in the order of time.

    Args:
        recording: with neutral orders, or with the commands of a Directed Perception unit.
        byte_s: transmission time of a byte.
        origin_ns: the capture time of 0 s.
    """
    raw = recording.motion_orders()
    if raw.size == 0:
        exchanges = (
            UnitExchange(
                # The unit cannot act before the last byte, the delimiter, has arrived.
                (c.request_time_ns - origin_ns) * 1e-9 + (len(c.command.strip()) + 1) * byte_s,
                (c.reply_time_ns - origin_ns) * 1e-9,
                c.code == CommandCode.OK,
                c.command,
            )
            for c in recording.ptu_commands()
        )
        return translate_exchanges(exchanges)
    request_s = (times_ns(raw["request_time"]) - origin_ns) * 1e-9 + raw["command_bytes"] * byte_s
    reply_s = (times_ns(raw["reply_time"]) - origin_ns) * 1e-9
    return [
        UnitOrder(
            float(request_s[k]),
            float(reply_s[k]),
            bool(row["accepted"]),
            AxisOrder(
                _KINDS[int(row["kind"])],
                _AXES[int(row["axis"])],
                float(row["steps"]),
                float(row["speed_steps"]),
            ),
        )
        for k, row in enumerate(raw)
        if int(row["kind"]) in _KINDS and int(row["axis"]) in _AXES
    ]


def translate_exchanges(exchanges: Iterable[UnitExchange]) -> list[UnitOrder]:
    """Return the orders in commands of a Directed Perception unit."""
    translator = MotionTranslator()
    return [
        UnitOrder(exchange.request_s, exchange.reply_s, exchange.ok, order)
        for exchange in exchanges
        for order in translator.translate(exchange.command, exchange.ok)
    ]
