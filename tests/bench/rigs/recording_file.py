"""An MCAP recording of a simulated rig, written with the plain `mcap` package.

Messages are CDR, little endian, aligned behind their four bytes of header. Nothing of the daemon's
recorder is used.
"""

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, Writer
from tests.bench.accuracy.profile import RAD_PER_STEP
from tests.bench.rigs.gyroscope import FULL_SCALE_RAD_S
from tests.bench.rigs.rig import PROGRAMS, SimulatedRig
from tests.bench.rigs.samples import (
    ACCEL_QUANTUM_M_S2,
    COUNTER_BITS,
    TEMPERATURE_OFFSET_DEGC,
    TEMPERATURE_QUANTUM_K,
    TICK_HZ,
)
from tests.bench.rigs.serial_session import BOTH_AXES

BOARD = "SIM-1"
START_NS = 1_790_000_000_000_000_000
MONOTONIC_NS = 5_000_000_000
UNIT_COUNTER_HZ = 90e6  # E-series: reply to CNF
ARCSEC_PER_STEP = float(np.degrees(RAD_PER_STEP) * 3600.0)
HEADER = b"\x00\x01\x00\x00"
PAN_ANSWERED, TILT_ANSWERED = 1, 2
PHASE_BEGIN, PHASE_END = 0, 1
CHUNK_BYTES = 1 << 20

_TIME = "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
_T = "builtin_interfaces/Time "
SCHEMAS = {
    "ImuRaw": f"{_T}host_time\nuint64 device_time\nuint32 sequence\nuint16 status\n"
    "int16 temperature\nint32[3] gyro\nint32[3] accel\nint32[3] mag\n",
    "PtuPosition": f"{_T}request_time\n{_T}first_byte_time\n{_T}reply_time\nint32 pan_steps\n"
    "int32 tilt_steps\nfloat64 pan\nfloat64 tilt\nuint64 controller_time\nuint32 sequence\n"
    "uint16 status\n",
    "PtuCommand": "uint8 OK=0\nuint8 ERROR=1\nuint8 TIMEOUT=2\nuint8 LIMIT=3\n"
    f"{_T}request_time\n{_T}first_byte_time\n{_T}reply_time\nuint32 sequence\nuint8 code\n"
    "string command\nstring reply\n",
    "SessionEvent": "uint8 PHASE_BEGIN=0\nuint8 PHASE_END=1\nuint8 NOTE=2\nuint8 FAULT=3\n"
    f"{_T}host_time\nuint8 kind\nstring phase\nstring text\n",
    "HostClock": f"{_T}monotonic_raw\n{_T}monotonic\n{_T}realtime\nfloat64 frequency_ppm\n"
    "float64 estimated_error\nuint32 ntp_status\n",
}
TOPICS = {
    "ImuRaw": f"/board/{BOARD}/imu_raw",
    "PtuPosition": "/ptu/position",
    "PtuCommand": "/ptu/command",
    "SessionEvent": "/session/event",
    "HostClock": "/host/clock",
}
Message = tuple[int, str, int, bytes]  # log time, type, sequence, bytes


def write_recording(rig: SimulatedRig, path: Path) -> None:
    """Write the recording of a rig."""
    messages = [
        *_board_messages(rig),
        *_position_messages(rig),
        *_command_messages(rig),
        *_event_messages(rig),
        *_clock_messages(rig),
    ]
    messages.sort(key=lambda message: message[0])
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="rig simulator of the tests")
        for name, values in _metadata(rig).items():
            writer.add_metadata(name, values)
        program = PROGRAMS / f"{rig.program.name}.yaml"
        if program.is_file():
            writer.add_attachment(
                START_NS, START_NS, "program.yaml", "application/yaml", program.read_bytes()
            )
        channels = {}
        for kind, text in SCHEMAS.items():
            schema = writer.register_schema(
                f"gyrorig_msgs/msg/{kind}", "ros2msg", (text + _TIME).encode()
            )
            channels[kind] = writer.register_channel(
                TOPICS[kind], "cdr", schema, {"offered_qos_profiles": ""}
            )
        for log_ns, kind, sequence, data in messages:
            writer.add_message(channels[kind], log_ns, data, log_ns, sequence)
        writer.finish()  # type: ignore[no-untyped-call]


def _metadata(rig: SimulatedRig) -> dict[str, dict[str, str]]:
    session, gyroscope = rig.session, rig.gyroscope
    unit = {
        "model": "PTU-E46-17.5",
        "dialect": "e46",
        "baud": f"{rig.baud:g}",
        "serial": f"SIM-{rig.seed}",
    }
    if rig.has_counter:
        unit["counter_hz"] = f"{UNIT_COUNTER_HZ:.0f}"
    for axis, low, high in (("pan", -3090, 3090), ("tilt", -907, 604)):
        unit |= {
            f"{axis}_resolution_arcsec": f"{ARCSEC_PER_STEP:.6f}",
            f"{axis}_min_steps": str(low),
            f"{axis}_max_steps": str(high),
            f"{axis}_base_speed": str(session.base_steps_s),
            f"{axis}_upper_speed": "2902",
            f"{axis}_acceleration": str(session.ramp_steps_s2),
        }
    board = {
        "uid": f"SIM{rig.seed:08d}",
        "model": "simulated",
        "sensor": "simulated",
        "firmware": "1",
        "config_hash": f"{gyroscope.nominal_hz:g}-{gyroscope.bandwidth_hz:g}",
        "link": "serial",
        "odr_hz": f"{gyroscope.nominal_hz:g}",
        "bandwidth_hz": f"{gyroscope.bandwidth_hz:g}",
        "gyro_full_scale_dps": f"{np.degrees(FULL_SCALE_RAD_S):g}",
        "gyro_scale_rad_s": repr(gyroscope.quantum_rad_s),
        "accel_scale_m_s2": repr(ACCEL_QUANTUM_M_S2),
        "temperature_scale_c": repr(TEMPERATURE_QUANTUM_K),
        "temperature_offset_c": repr(TEMPERATURE_OFFSET_DEGC),
        "tick_hz": repr(TICK_HZ),
        "counter_bits": str(COUNTER_BITS),
    }
    session_facts = {
        "format": "1",
        "session": f"sim-{rig.seed}",
        "rig": f"simulated-{rig.seed}",
        "part": "0",
        "previous": "",
        "anchor_utc_ns": str(START_NS),
        "anchor_monotonic_raw_ns": str(MONOTONIC_NS),
        "software": "rig simulator of the tests",
        "host": "simulated",
    }
    return {"gyrorig": session_facts, "gyrorig.ptu": unit, f"gyrorig.board.{BOARD}": board}


def _ns(time_s: float) -> int:
    return START_NS + round(time_s * 1e9)


def _split(time_ns: int) -> tuple[int, int]:
    return divmod(time_ns, 1_000_000_000)


def _board_messages(rig: SimulatedRig) -> Iterator[Message]:
    stream, pack = rig.stream, struct.Struct("<iIQIHh9i").pack
    rows = zip(
        stream.host_s.tolist(), stream.ticks.tolist(), stream.number.tolist(),
        stream.status.tolist(), stream.temperature.tolist(), stream.gyro.tolist(),
        stream.accel.tolist(), strict=True,
    )  # fmt: skip
    for k, (host_s, ticks, number, status, temperature, gyro, accel) in enumerate(rows):
        at_ns = _ns(host_s)
        data = pack(*_split(at_ns), ticks, number, status, temperature, *gyro, *accel, 0, 0, 0)
        yield at_ns, "ImuRaw", k, HEADER + data


def answered_counts(rig: SimulatedRig, axis: int) -> list[int]:
    """Return the counts that the polls answer: behind the motion by a part of a step."""
    session, edges_s = rig.session, rig.tracks.edges_s
    steps = rig.tracks.counted[axis]
    at_s = session.polls.instant_s
    where = np.interp(at_s, edges_s, steps)
    cell = np.clip(np.searchsorted(edges_s, at_s) - 1, 0, steps.size - 2)
    way = np.diff(steps)[cell]
    moving = np.abs(way) > 1e-9
    where = where + moving * (session.count_shift - np.sign(way) * session.count_lag)
    return [int(count) for count in np.rint(where)]


def _position_messages(rig: SimulatedRig) -> Iterator[Message]:
    polls = rig.session.polls
    pack = struct.Struct("<iIiIiIii2dQIH").pack
    counts = (answered_counts(rig, 0), answered_counts(rig, 1))
    rate_hz = UNIT_COUNTER_HZ * (1.0 + rig.counter_skew)
    for k in range(polls.instant_s.size):
        axis = int(polls.axis[k])
        times = [_ns(float(t[k])) for t in (polls.request_s, polls.first_byte_s, polls.reply_s)]
        answered = (axis in (0, BOTH_AXES), axis in (1, BOTH_AXES))
        pan, tilt = (counts[a][k] if answered[a] else 0 for a in (0, 1))
        ticks = 0
        if rig.has_counter:
            ticks = (rig.counter_start + int(polls.instant_s[k] * rate_hz)) % 2**32
        data = pack(
            *(part for time_ns in times for part in _split(time_ns)),
            pan, tilt, pan * RAD_PER_STEP, tilt * RAD_PER_STEP, ticks, k,
            PAN_ANSWERED * answered[0] | TILT_ANSWERED * answered[1],
        )  # fmt: skip
        yield times[2], "PtuPosition", k, HEADER + data


def _string(data: bytearray, text: str) -> None:
    data += b"\0" * (-len(data) % 4)
    content = text.encode() + b"\0"
    data += struct.pack("<I", len(content)) + content


def _command_messages(rig: SimulatedRig) -> Iterator[Message]:
    for k, exchange in enumerate(rig.session.exchanges):
        times = [_ns(t) for t in (exchange.request_s, exchange.first_byte_s, exchange.reply_s)]
        parts = (part for time_ns in times for part in _split(time_ns))
        data = bytearray(struct.pack("<iIiIiIIB", *parts, k, 0))
        _string(data, exchange.text)
        _string(data, "*")
        yield times[2], "PtuCommand", k, HEADER + bytes(data)


def _event_messages(rig: SimulatedRig) -> Iterator[Message]:
    for k, (kind, time_s) in enumerate(((PHASE_BEGIN, 0.0), (PHASE_END, rig.session.end_s))):
        data = bytearray(struct.pack("<iIB", *_split(_ns(time_s)), kind))
        _string(data, "program")
        _string(data, "")
        yield _ns(time_s), "SessionEvent", k, HEADER + bytes(data)


def _clock_messages(rig: SimulatedRig) -> Iterator[Message]:
    for second in range(int(rig.session.end_s) + 1):
        at_ns = START_NS + second * 1_000_000_000
        raw = _split(MONOTONIC_NS + second * 1_000_000_000)
        data = struct.pack("<6i2dI", *raw, *raw, *_split(at_ns), 0.0, 1e-4, 0)
        yield at_ns, "HostClock", second, HEADER + data
