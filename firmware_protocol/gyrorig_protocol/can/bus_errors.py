"""CAN error frames: the reports of a CAN controller about its bus, as Linux encodes them.

Source: <linux/can/error.h>. The identifier of an error frame contains classes, its data contains
details. The reports that matter to a rig have a name; all others count as a bus error.
"""

from enum import Enum

from gyrorig_protocol.can.can_frame import CanFrame, FrameFlag

_TX_TIMEOUT = 0x001
_CONTROLLER = 0x004
_PROTOCOL = 0x008
_NO_ACK = 0x020
_BUS_OFF = 0x040
_RESTARTED = 0x100
_REPORT = int(FrameFlag.ERROR)

# data[1] of the class "controller"
_RX_OVERFLOW, _TX_OVERFLOW = 0x01, 0x02
_WARNING = 0x04 | 0x08
_PASSIVE = 0x10 | 0x20
_ACTIVE = 0x40


class BusReport(Enum):
    """A report of the controller; the value is the text for people."""

    BUS_OFF = "the controller has left the bus (bus-off)"
    RESTARTED = "the controller is on the bus again"
    ERROR_PASSIVE = "the controller is error-passive"
    ERROR_WARNING = "the controller warns of errors"
    ERROR_ACTIVE = "the controller is error-active again"
    RX_OVERFLOW = "the controller lost a frame, because its receive buffer was full"
    TX_OVERFLOW = "the controller's send queue is full"
    TX_TIMEOUT = "a frame was not sent in time"
    NO_ACK = "no other node acknowledged a frame"
    OTHER = "an error on the bus"


# The most severe report comes first; the end of a state comes after its begin.
_BY_CLASS = (
    (_BUS_OFF, BusReport.BUS_OFF),
    (_RESTARTED, BusReport.RESTARTED),
    (_TX_TIMEOUT, BusReport.TX_TIMEOUT),
    (_NO_ACK, BusReport.NO_ACK),
)
_BY_CONTROLLER = (
    (_PASSIVE, BusReport.ERROR_PASSIVE),
    (_WARNING, BusReport.ERROR_WARNING),
    (_RX_OVERFLOW, BusReport.RX_OVERFLOW),
    (_TX_OVERFLOW, BusReport.TX_OVERFLOW),
    (_ACTIVE, BusReport.ERROR_ACTIVE),
)


def bus_reports(frame: CanFrame) -> list[BusReport]:
    """Return the reports of an error frame, the most severe first; never empty."""
    reports = [report for mask, report in _BY_CLASS if frame.identifier & mask]
    if frame.identifier & _CONTROLLER and len(frame.data) > 1:
        detail = frame.data[1]
        reports += [report for mask, report in _BY_CONTROLLER if detail & mask]
    return reports or [BusReport.OTHER]


def error_frame(report: BusReport, stamp_ns: int = 0) -> CanFrame:
    """Return the error frame with one report, for a simulated bus."""
    for mask, candidate in _BY_CLASS:
        if candidate is report:
            return CanFrame(mask, bytes(8), _REPORT, stamp_ns)
    for mask, candidate in _BY_CONTROLLER:
        if candidate is report:
            return CanFrame(_CONTROLLER, bytes([0, mask, 0, 0, 0, 0, 0, 0]), _REPORT, stamp_ns)
    return CanFrame(_PROTOCOL, bytes(8), _REPORT, stamp_ns)
