"""What a CAN controller reports about its bus: error frames as Linux words them.

Source: <linux/can/error.h>. An error frame's identifier holds classes, its data details.
Only what a rig must know is named; everything else counts as a bus error.
"""

from enum import Enum

from gyrorig_protocol.can.frame import CanFrame, FrameFlag

_TX_TIMEOUT = 0x001
_CONTROLLER = 0x004
_PROTOCOL = 0x008
_NO_ACK = 0x020
_BUS_OFF = 0x040
_RESTARTED = 0x100
_REPORT = int(FrameFlag.ERROR)

# data[1] where the class is the controller's
_RX_OVERFLOW, _TX_OVERFLOW = 0x01, 0x02
_WARNING = 0x04 | 0x08
_PASSIVE = 0x10 | 0x20
_ACTIVE = 0x40


class BusReport(Enum):
    """What was reported; the value says it in words."""

    BUS_OFF = "the controller has left the bus (bus-off)"
    RESTARTED = "the controller has come back to the bus"
    ERROR_PASSIVE = "the controller is error-passive"
    ERROR_WARNING = "the controller warns of errors"
    ERROR_ACTIVE = "the controller is error-active again"
    RX_OVERFLOW = "the controller had no room for a frame"
    TX_OVERFLOW = "the controller's queue to send is full"
    TX_TIMEOUT = "a frame was not sent in time"
    NO_ACK = "nobody acknowledged a frame"
    OTHER = "an error on the bus"


# Of several in one frame the gravest comes first; a state's end after its begin.
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
    """Return what an error frame reports, the gravest first; never empty."""
    reports = [report for mask, report in _BY_CLASS if frame.identifier & mask]
    if frame.identifier & _CONTROLLER and len(frame.data) > 1:
        detail = frame.data[1]
        reports += [report for mask, report in _BY_CONTROLLER if detail & mask]
    return reports or [BusReport.OTHER]


def error_frame(report: BusReport, stamp_ns: int = 0) -> CanFrame:
    """Return the error frame that reports so: what a scripted bus sends."""
    for mask, known in _BY_CLASS:
        if known is report:
            return CanFrame(mask, bytes(8), _REPORT, stamp_ns)
    for mask, known in _BY_CONTROLLER:
        if known is report:
            return CanFrame(_CONTROLLER, bytes([0, mask, 0, 0, 0, 0, 0, 0]), _REPORT, stamp_ns)
    return CanFrame(_PROTOCOL, bytes(8), _REPORT, stamp_ns)
