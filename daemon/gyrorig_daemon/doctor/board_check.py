"""Checks of a board on a serial port: format, identity, sample rate, losses.

What to use when: `check_board` for a port that can be opened. It opens the port (which resets
many Arduinos), requests HELLO and listens for a few seconds; nothing is set.
"""

import random
import time
from dataclasses import dataclass, field

from gyrorig_daemon.config import BoardPort
from gyrorig_daemon.config.rig_document import BITS_PER_BYTE
from gyrorig_daemon.doctor.finding import Finding, fault, ok, warning
from gyrorig_daemon.doctor.port_session import open_for_check, receive, send
from gyrorig_daemon.links.ports.serial_port import PortRefusedError, configure_raw
from gyrorig_protocol.board import (
    Batch,
    FrameEvent,
    Hello,
    Sample,
    Slow,
    TimeReply,
)
from gyrorig_protocol.board.json_frames import PROTOCOL_VERSION
from gyrorig_protocol.board_protocols import SerialParser, SerialProtocol, find_serial_protocol

FIRST_BYTE_TIMEOUT_S = 5.0  # an Arduino that was reset by opening the port starts after 1 to 2 s
REQUEST_PERIOD_S = 0.5
MEASURE_S = 2.0  # at 100 samples per second: the rate to half a percent
BAUD_TRIAL_S = 1.5
MAX_KEPT_BYTES = 4096
# The most common rates first: those that divide exactly, then those common on an Arduino.
USUAL_BAUDS = (460800, 115200, 921600, 230400, 250000, 500000, 1000000, 57600, 38400, 9600)
MAX_LINE_LOAD = 0.7  # of the line's capacity; beyond it the writes of an AVR block
RATE_TOLERANCE = 0.1  # data sheets allow 5 to 8 %
SEQUENCE_MODULUS = 1 << 16


@dataclass(slots=True)
class BoardTraffic:
    """Data received from a board during the check."""

    raw: bytearray = field(default_factory=bytearray)  # the beginning
    total_bytes: int = 0
    samples: int = 0
    first_samples: int = 0  # of the first frame; they were taken before the measurement
    missing: int = 0
    first_sample_s: float = 0.0  # of the first and last sample; monotonic
    last_sample_s: float = 0.0
    hello: Hello | None = None
    slow: Slow | None = None
    time_replies: int = 0
    time_requests: int = 0
    flags: int = 0
    damaged_frames: int = 0
    has_hung_up: bool = False
    last_sequence: int | None = None

    @property
    def rate_hz(self) -> float:
        """Samples per second; 0 if all samples came together."""
        elapsed_s = self.last_sample_s - self.first_sample_s
        return (self.samples - self.first_samples) / elapsed_s if elapsed_s > 0.0 else 0.0


def check_board(config: BoardPort) -> tuple[list[Finding], float]:
    """Return the findings about the board on `config.port`, and its samples per second."""
    subject = f"board {config.id}"
    try:
        with open_for_check(config.port, config.baud) as fd:
            traffic = _listen(fd, config)
            other_baud = (
                None if traffic.samples or not traffic.total_bytes else _find_other_baud(fd, config)
            )
    except PortRefusedError as error:
        message = f"the port {config.port} of the board cannot be opened ({error})"
        return [
            fault(subject, error.reason, message, "see the other findings about this port")
        ], 0.0
    findings = _check_format(subject, config, traffic, other_baud)
    if traffic.samples:
        findings += [*_check_rate(subject, config, traffic), *_check_losses(subject, traffic)]
    return findings, traffic.rate_hz


def _listen(fd: int, config: BoardPort) -> BoardTraffic:
    """Ask and listen until the board is known and was heard for `MEASURE_S`, or patience ends."""
    protocol = find_serial_protocol(config.format)
    traffic, parser = BoardTraffic(), protocol.make_parser(config)
    start_s = time.monotonic()
    end_s, next_request_s = start_s + FIRST_BYTE_TIMEOUT_S + MEASURE_S, start_s
    while (now_s := time.monotonic()) < end_s and not traffic.has_hung_up:
        if protocol.identifies_itself and now_s >= next_request_s:
            next_request_s = now_s + REQUEST_PERIOD_S
            send(fd, _next_request(protocol, traffic))
        _parse_bytes(receive(fd, min(end_s, next_request_s)), parser, traffic)
        is_identified = traffic.hello is not None or not protocol.identifies_itself
        if (
            is_identified
            and traffic.samples
            and traffic.last_sample_s - traffic.first_sample_s >= MEASURE_S
        ):
            break
        if not traffic.total_bytes and now_s - start_s > FIRST_BYTE_TIMEOUT_S:
            break
    traffic.damaged_frames = sum(parser.faults.values())
    return traffic


def _next_request(protocol: SerialProtocol, traffic: BoardTraffic) -> bytes:
    if traffic.hello is None or not protocol.answers_time_requests:
        return protocol.hello_request()
    traffic.time_requests += 1
    return protocol.time_request(random.getrandbits(32), time.monotonic_ns())


def _parse_bytes(data: bytes | None, parser: SerialParser, traffic: BoardTraffic) -> None:
    if data is None:
        traffic.has_hung_up = True
        return
    now_s = time.monotonic()
    traffic.total_bytes += len(data)
    traffic.raw += data[: MAX_KEPT_BYTES - len(traffic.raw)]
    for event in parser.feed(data, 0):
        if not isinstance(event, FrameEvent):
            continue
        match event.frame:
            case Sample() | Batch():
                _count_samples(event.frame, now_s, traffic)
            case Hello():
                traffic.hello = event.frame
            case Slow():
                traffic.slow = event.frame
            case TimeReply():
                traffic.time_replies += 1


def _count_samples(frame: Sample | Batch, now_s: float, traffic: BoardTraffic) -> None:
    count = len(frame.gyro) if isinstance(frame, Batch) else 1
    if traffic.last_sequence is not None:
        step = (frame.sequence - traffic.last_sequence) % SEQUENCE_MODULUS
        if 1 < step < SEQUENCE_MODULUS // 2:
            traffic.missing += step - 1
    else:
        traffic.first_sample_s, traffic.first_samples = now_s, count
    traffic.last_sequence = (frame.sequence + count - 1) % SEQUENCE_MODULUS
    traffic.last_sample_s = now_s
    traffic.samples += count
    traffic.flags |= frame.flags


def _find_other_baud(fd: int, config: BoardPort) -> int | None:
    """Return another baud rate at which frames arrive, None if there is none."""
    protocol = find_serial_protocol(config.format)
    if not protocol.identifies_itself:
        return None
    for baud in USUAL_BAUDS:
        if baud == config.baud:
            continue
        try:
            configure_raw(fd, baud)
        except PortRefusedError:
            continue
        traffic, parser = BoardTraffic(), protocol.make_parser(config)
        end_s = time.monotonic() + BAUD_TRIAL_S
        while time.monotonic() < end_s and not traffic.has_hung_up:
            _parse_bytes(receive(fd, end_s), parser, traffic)
            if traffic.samples > 10:
                return baud
    return None


def _check_format(
    subject: str, config: BoardPort, traffic: BoardTraffic, other_baud: int | None
) -> list[Finding]:
    """Return whether the board sends the configured format, and its identity."""
    port = config.port
    if traffic.has_hung_up:
        remedy = "check the cable and the power of the board"
        return [
            fault(
                subject,
                "hung_up",
                f"the device on the port {port} disconnected during the check",
                remedy,
            )
        ]
    if not traffic.total_bytes:
        remedy = (
            "check the power, the cable and the firmware of the board, and press its reset button"
        )
        return [fault(subject, "silent", f"the board sends no data to the port {port}", remedy)]
    if other_baud is not None:
        message = f"the board sends at {other_baud} baud, but the rig file has {config.baud} baud"
        return [
            fault(
                subject,
                "wrong_baud",
                message,
                f"set `baud` of the board to {other_baud} in the rig file",
            )
        ]
    if not traffic.samples:
        return [_unknown_data(subject, config, bytes(traffic.raw))]
    protocol = find_serial_protocol(config.format)
    if not protocol.identifies_itself:
        message = f"the board sends {protocol.description} at {config.baud} baud"
        return [ok(subject, "identity", message)]
    return _check_identity(subject, config, traffic)


def _check_identity(subject: str, config: BoardPort, traffic: BoardTraffic) -> list[Finding]:
    """Return the identity of a GCB1 board, and whether it is sufficient."""
    hello = traffic.hello
    if hello is None:
        remedy = (
            "load the firmware of this project, or another firmware that answers HELLO requests"
        )
        return [
            fault(
                subject,
                "no_hello",
                "the board sends samples, but it does not identify itself",
                remedy,
            )
        ]
    sensor_names = ", ".join(_sensor_name(sensor.who) for sensor in hello.sensors)
    message = f"{hello.board}, uid {hello.uid}, firmware {hello.fw}, sensors {sensor_names}"
    findings = [ok(subject, "identity", f"{message}, start {hello.boot}, at {config.baud} baud")]
    if hello.protocol != PROTOCOL_VERSION:
        message = (
            f"the board uses version {hello.protocol} of the protocol, but this program uses "
            f"version {PROTOCOL_VERSION}"
        )
        findings.append(
            fault(
                subject,
                "protocol",
                message,
                "load a firmware with the same protocol version as this program",
            )
        )
    if config.facts.uid and hello.uid and hello.uid != config.facts.uid:
        message = f"the board has the uid {hello.uid}, but the rig file has {config.facts.uid}"
        remedy = (
            "check which board is connected to this port, or correct `uid` under `facts` of the "
            "board"
        )
        findings.append(fault(subject, "wrong_board", message, remedy))
    if not hello.uid and not config.facts.uid:
        message = (
            "the board sends no unique id, and the rig file has none. If you connect another board "
            "to this port, the program treats the two boards as one board"
        )
        findings.append(
            fault(
                subject,
                "no_uid",
                message,
                "choose an id, and set it as `uid` under `facts` of the board in the rig file. "
                "Write the id on the board, too, to distinguish it from others",
            )
        )
    if traffic.time_requests > 1 and not traffic.time_replies:
        message = f"the board has not answered {traffic.time_requests} time requests"
        findings.append(
            warning(
                subject,
                "deaf",
                message,
                "check the wire from the computer to the RX pin of the board",
            )
        )
    return findings


def _sensor_name(sensor_id: int | str) -> str:
    return f"0x{sensor_id:02X}" if isinstance(sensor_id, int) else sensor_id


def _unknown_data(subject: str, config: BoardPort, raw: bytes) -> Finding:
    """Return the finding about data without samples."""
    printable = sum(32 <= byte < 127 or byte in b"\r\n\t" for byte in raw)
    expected = find_serial_protocol(config.format).description
    if printable > 0.95 * len(raw):
        if config.columns is not None:
            message = (
                f"the board sends the text {raw[:40]!r}, in which the daemon finds no samples with "
                "`columns` of the rig file"
            )
            remedy = "correct `columns` of the board in the rig file"
            return fault(subject, "columns", message, remedy)
        message = f"the board sends the text {raw[:40]!r}, but the rig file expects {expected}"
        remedy = (
            "if the text contains the samples, set `format: text` and `columns` of the board "
            "in the rig file. Otherwise check the firmware of the board"
        )
        return fault(subject, "text", message, remedy)
    message = (
        f"the board sends {raw[:16]!r}, which contains no {config.format} frame at any usual "
        "baud rate"
    )
    return fault(
        subject,
        "garbage",
        message,
        "check the port, the baud rate, the firmware and the wires of the board",
    )


def _check_rate(subject: str, config: BoardPort, traffic: BoardTraffic) -> list[Finding]:
    """Return whether the sample rate is nominal, and whether the line has enough capacity."""
    rate_hz = traffic.rate_hz
    nominal_hz = config.facts.odr_hz
    if traffic.hello is not None:
        nominal_hz = traffic.hello.sensors[0].rate_hz or nominal_hz
    line_load = (
        traffic.total_bytes
        * BITS_PER_BYTE
        / config.baud
        / max(traffic.last_sample_s - traffic.first_sample_s, 0.1)
    )
    summary = (
        f"{rate_hz:.0f} samples per second, which use {line_load:.0%} of the capacity of the line"
    )
    if nominal_hz and rate_hz and abs(rate_hz / nominal_hz - 1.0) > RATE_TOLERANCE:
        message = (
            f"the board sends {summary}, but its nominal rate is {nominal_hz:g} samples per second"
        )
        remedy = (
            "increase the baud rate and the clock of the sensor bus, send several samples "
            "per frame, or reduce the sample rate"
        )
        return [warning(subject, "rate", message, remedy)]
    if line_load > MAX_LINE_LOAD:
        remedy = "increase the baud rate, or send several samples per frame"
        return [
            warning(
                subject,
                "line_full",
                f"the board sends {summary}. If samples have to wait, the line is too slow to "
                "catch up",
                remedy,
            )
        ]
    return [ok(subject, "rate", summary)]


def _check_losses(subject: str, traffic: BoardTraffic) -> list[Finding]:
    """Return the losses during the check, and those that the board reports."""
    findings = []
    # the frame that was being sent when the port was opened is always damaged
    if traffic.damaged_frames > 1 or traffic.missing:
        message = (
            f"during the check, {traffic.missing} samples were missing and "
            f"{traffic.damaged_frames} frames were damaged, of {traffic.samples} samples"
        )
        remedy = (
            "check the cable and the ground connection, and use a shorter cable or a lower baud "
            "rate"
        )
        findings.append(warning(subject, "damaged", message, remedy))
    slow = traffic.slow
    if slow is None:
        return findings
    for count, event, remedy in (
        (
            slow.sensor_overruns,
            "samples that the sensor lost because the board read them too late",
            "increase the clock of the sensor bus, or reduce the sample rate",
        ),
        (
            slow.frames_dropped,
            "frames that the board could not send because the line was busy",
            "increase the baud rate, or send several samples per frame",
        ),
        (
            slow.bus_errors,
            "errors on the bus between the board and its sensor",
            "check the wires and the pull-up resistors of this bus",
        ),
    ):
        if count:
            message = f"the board reports {count} {event}, counted since the start of the board"
            findings.append(warning(subject, "board_losses", message, remedy))
    return findings
