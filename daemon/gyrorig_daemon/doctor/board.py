"""One board on a serial port: whether it speaks, at what rate, and what it says of itself.

What to use when: `examine_board`, for a port that can be opened. It opens the port (which
resets many Arduinos), asks for HELLO, and listens for a few seconds; nothing is set.
"""

import random
import time
from dataclasses import dataclass, field

from gyrorig_daemon.config import BoardPort
from gyrorig_daemon.config.document import BITS_PER_BYTE
from gyrorig_daemon.doctor.finding import Finding, fault, ok, warning
from gyrorig_daemon.doctor.line import opened, receive, send
from gyrorig_daemon.links.board_facts import make_parser
from gyrorig_daemon.links.serial_port import RefusedError, make_raw
from gyrorig_protocol.board import (
    Batch,
    FrameEvent,
    FrameParser,
    Hello,
    HelloRequest,
    Sample,
    Slow,
    TextLineParser,
    TimeReply,
    TimeRequest,
)
from gyrorig_protocol.board.hello import PROTOCOL

PATIENCE_S = 5.0  # an Arduino that was reset by the opening begins after 1 to 2 s
HELLO_EVERY_S = 0.5
LISTEN_S = 2.0  # at 100 samples a second: the rate to half a percent
TRY_BAUD_S = 1.5
HEARD_BYTES = 4096
# Most boards first: those whose clock divides exactly, then the Arduino's usual ones.
USUAL_BAUDS = (460800, 115200, 921600, 230400, 250000, 500000, 1000000, 57600, 38400, 9600)
LINE_FULL = 0.7  # of the line's rate: more is unsafe, a board's writes block (boards.md sec. 2)
RATE_TOLERANCE = 0.1  # data sheets allow 5 to 8 %
SEQUENCE = 1 << 16


@dataclass(slots=True)
class Heard:
    """What came from a board while it was listened to."""

    raw: bytearray = field(default_factory=bytearray)  # the beginning
    total_bytes: int = 0
    samples: int = 0
    missing: int = 0
    first_s: float = 0.0  # of the first and last sample; monotonic
    last_s: float = 0.0
    hello: Hello | None = None
    slow: Slow | None = None
    replies: int = 0
    asked: int = 0
    flags: int = 0
    faults: int = 0
    hung_up: bool = False
    last_sequence: int | None = None

    @property
    def rate_hz(self) -> float:
        """Samples a second; 0 where there are too few to say."""
        return (self.samples - 1) / (self.last_s - self.first_s) if self.samples > 10 else 0.0


def examine_board(config: BoardPort) -> tuple[list[Finding], float]:
    """Return what the board on `config.port` shows, and its samples a second."""
    subject = f"board {config.id}"
    try:
        with opened(config.port, config.baud) as fd:
            heard = _listen(fd, config)
            other = None if heard.samples or not heard.total_bytes else _other_baud(fd, config)
    except RefusedError as refused:
        what = f"{config.port} cannot be opened: {refused}"
        return [fault(subject, refused.reason, what, "see the findings on its port")], 0.0
    findings = _speech(subject, config, heard, other)
    if heard.samples:
        findings += [*_rate(subject, config, heard), *_losses(subject, heard)]
    return findings, heard.rate_hz


def _listen(fd: int, config: BoardPort) -> Heard:
    """Ask and listen until the board is known and was heard for `LISTEN_S`, or patience ends."""
    heard, parser = Heard(), make_parser(config)
    speaks = config.format == "gcb1"
    begun_s = time.monotonic()
    end_s, ask_s = begun_s + PATIENCE_S + LISTEN_S, begun_s
    while (now_s := time.monotonic()) < end_s and not heard.hung_up:
        if speaks and now_s >= ask_s:
            ask_s = now_s + HELLO_EVERY_S
            send(fd, _question(heard))
        _take(receive(fd, min(end_s, ask_s)), parser, heard)
        known = heard.hello is not None or not speaks
        if known and heard.samples and heard.last_s - heard.first_s >= LISTEN_S:
            break
        if not heard.total_bytes and now_s - begun_s > PATIENCE_S:
            break
    heard.faults = sum(parser.faults.values())
    return heard


def _question(heard: Heard) -> bytes:
    if heard.hello is None:
        return HelloRequest().encode()
    heard.asked += 1
    return TimeRequest(random.getrandbits(32), time.monotonic_ns()).encode()


def _take(data: bytes | None, parser: FrameParser | TextLineParser, heard: Heard) -> None:
    if data is None:
        heard.hung_up = True
        return
    now_s = time.monotonic()
    heard.total_bytes += len(data)
    heard.raw += data[: HEARD_BYTES - len(heard.raw)]
    for event in parser.feed(data, 0):
        if not isinstance(event, FrameEvent):
            continue
        match event.frame:
            case Sample() | Batch():
                _count(event.frame, now_s, heard)
            case Hello():
                heard.hello = event.frame
            case Slow():
                heard.slow = event.frame
            case TimeReply():
                heard.replies += 1


def _count(frame: Sample | Batch, now_s: float, heard: Heard) -> None:
    count = len(frame.gyro) if isinstance(frame, Batch) else 1
    if heard.last_sequence is not None:
        step = (frame.sequence - heard.last_sequence) % SEQUENCE
        if 1 < step < SEQUENCE // 2:
            heard.missing += step - 1
    else:
        heard.first_s = now_s
    heard.last_sequence = (frame.sequence + count - 1) % SEQUENCE
    heard.last_s = now_s
    heard.samples += count
    heard.flags |= frame.flags


def _other_baud(fd: int, config: BoardPort) -> int | None:
    """Return the rate at which frames come, where they do not at the configured one."""
    if config.format != "gcb1":
        return None
    for baud in USUAL_BAUDS:
        if baud == config.baud:
            continue
        try:
            make_raw(fd, baud)
        except RefusedError:
            continue
        heard, parser, end_s = Heard(), FrameParser(), time.monotonic() + TRY_BAUD_S
        while time.monotonic() < end_s and not heard.hung_up:
            _take(receive(fd, end_s), parser, heard)
            if heard.samples > 10:
                return baud
    return None


def _speech(subject: str, config: BoardPort, heard: Heard, other: int | None) -> list[Finding]:
    """Return whether it speaks as configured, and who it says it is."""
    port = config.port
    if heard.hung_up:
        remedy = "check the cable and the board's power"
        return [fault(subject, "hung_up", f"{port} hung up", remedy)]
    if not heard.total_bytes:
        remedy = "check its power, the cable and its firmware; press its reset button"
        return [fault(subject, "silent", f"nothing comes on {port}", remedy)]
    if other is not None:
        what = f"it sends at {other} baud, and the configuration says {config.baud}"
        return [fault(subject, "wrong_baud", what, f"set its baud to {other}")]
    if not heard.samples:
        return [_foreign(subject, config, bytes(heard.raw))]
    if config.format == "text":
        return [ok(subject, "identity", f"it sends lines of numbers at {config.baud} baud")]
    return _identity(subject, config, heard)


def _identity(subject: str, config: BoardPort, heard: Heard) -> list[Finding]:
    """Return who a board that speaks GCB1 says it is, and whether that is enough."""
    hello = heard.hello
    if hello is None:
        remedy = "load the firmware of this project, or one that answers HELLO requests"
        return [fault(subject, "no_hello", "it sends samples and does not say who it is", remedy)]
    parts = ", ".join(_part(sensor.who) for sensor in hello.sensors)
    what = f"{hello.board}, uid {hello.uid}, firmware {hello.fw}, sensors {parts}"
    found = [ok(subject, "identity", f"{what}, start {hello.boot}, at {config.baud} baud")]
    if hello.protocol != PROTOCOL:
        what = f"it speaks version {hello.protocol} of the protocol, this program {PROTOCOL}"
        found.append(fault(subject, "protocol", what, "load matching firmware"))
    if config.facts.uid and hello.uid and hello.uid != config.facts.uid:
        what = f"its uid is {hello.uid}, and the rig's board has {config.facts.uid}"
        remedy = "check which board is on this port, or change its facts"
        found.append(fault(subject, "wrong_board", what, remedy))
    if not hello.uid and not config.facts.uid:
        what = "it has no unique number: its calibration would go to whatever is on this port"
        found.append(fault(subject, "no_uid", what, "give boards: facts: uid, and label the board"))
    if heard.asked > 1 and not heard.replies:
        what = f"it does not answer {heard.asked} questions for its clock"
        found.append(warning(subject, "deaf", what, "check the line to the board (its RX)"))
    return found


def _part(who: int | str) -> str:
    return f"0x{who:02X}" if isinstance(who, int) else who


def _foreign(subject: str, config: BoardPort, raw: bytes) -> Finding:
    """Return what is said of bytes that hold no sample."""
    printable = sum(32 <= byte < 127 or byte in b"\r\n\t" for byte in raw)
    if printable > 0.95 * len(raw):
        what = f"it sends text, {raw[:40]!r}, in which no sample is found"
        if config.format == "gcb1":
            return fault(subject, "text", what, "set format: text, and name its columns")
        return fault(subject, "columns", what, "check its columns in the configuration")
    what = f"it sends {raw[:16]!r}: no {config.format} frame at any usual rate"
    return fault(subject, "garbage", what, "check port, baud and firmware; a wire may be loose")


def _rate(subject: str, config: BoardPort, heard: Heard) -> list[Finding]:
    """Return whether samples come as often as it says, and whether the line carries them."""
    rate_hz = heard.rate_hz
    said_hz = config.facts.odr_hz
    if heard.hello is not None:
        said_hz = heard.hello.sensors[0].rate_hz or said_hz
    share = heard.total_bytes * BITS_PER_BYTE / config.baud / max(heard.last_s - heard.first_s, 0.1)
    says = f"{rate_hz:.0f} samples a second, {share:.0%} of the line"
    if said_hz and rate_hz and abs(rate_hz / said_hz - 1.0) > RATE_TOLERANCE:
        what = f"{says}; it should be {said_hz:g}"
        remedy = (
            "raise the baud rate and the sensor bus' rate (100 kHz is slow), batch samples, or "
            "lower the rate"
        )
        return [warning(subject, "rate", what, remedy)]
    if share > LINE_FULL:
        remedy = "raise the baud rate, or send several samples in a frame (batch)"
        return [warning(subject, "line_full", f"{says}: it cannot catch up after a stall", remedy)]
    return [ok(subject, "rate", says)]


def _losses(subject: str, heard: Heard) -> list[Finding]:
    """Return what was lost while it was listened to, and what the board has lost before."""
    found = []
    # the frame that was under way when the port was opened is one fault, and no fault
    if heard.faults > 1 or heard.missing:
        what = (
            f"{heard.missing} samples missing and {heard.faults} damaged frames of {heard.samples}"
        )
        remedy = "check cable and ground; a shorter cable, or a lower baud rate"
        found.append(warning(subject, "damaged", what, remedy))
    slow = heard.slow
    if slow is not None and (slow.sensor_overruns or slow.frames_dropped or slow.bus_errors):
        what = (
            f"since its start the board has lost {slow.sensor_overruns} samples to its sensor's "
            f"queue and {slow.frames_dropped} frames to its line, with {slow.bus_errors} bus errors"
        )
        remedy = "of bus errors check its wires and pull-ups, of dropped frames raise the baud rate"
        found.append(warning(subject, "board_losses", what, remedy))
    return found
