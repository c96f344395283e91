"""Long recordings of a simulated rig, made in pieces: minutes of processor time, not hours.

What to use when: `write_long` for a recording of any length with one board at 800 Hz on a
pan-tilt unit that repeats a program; `bench_growth.py` runs this file as a process of its
own. The emulator is the better rig, but it plays in real time.

The motion is the unit's: trapezoids that leap to the base speed, one delay for each move,
positions counted in whole steps at an instant inside the exchange. The board: an L3G4200D
behind a second-order low-pass, with gain, bias and its walk, white noise and rounding, a
crystal with skew and wander, and a line with jitter and stalls. One minute is held at a time.

Run: python tests/bench/long_recording.py OUT.mcap [--seconds 600] [--seed 1]
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.clock_messages import ClockPing, clock_ping_topic
from gyrorig_protocol.recording.messages import (
    PTU_COMMAND_TOPIC,
    PTU_POSITION_TOPIC,
    SESSION_EVENT_TOPIC,
    EventKind,
    ImuStatus,
    PtuCommandRecord,
    PtuPosition,
    PtuStatus,
    SessionEvent,
)
from gyrorig_protocol.recording.writer import RecordingWriter

FloatArray = NDArray[np.float64]
Command = tuple[float, float, str]  # asked, answered, text

BOARD = BoardId("LONG-1")
START_NS = 1_790_000_000_000_000_000
RATE_HZ = 800.0
FINE = 4  # steps of the simulated low-pass to a sample
BANDWIDTH_HZ = 110.0
GYRO_SCALE_RAD_S = float(np.radians(8.75e-3))  # L3G4200D data sheet, +-250 dps
ACCEL_SCALE_M_S2 = 0.0383072265625
NOISE_RAD_S_RTHZ = float(np.radians(0.03))  # the same data sheet
BIAS_WALK_RAD_S_RTS = 4e-6
GRAVITY_M_S2 = 9.80665
ARCSEC = 185.142857
RAD_PER_STEP = float(np.radians(ARCSEC / 3600.0))
BASE_STEPS_S, ACCELERATION_STEPS_S2 = 58.0, 3889.0
POLL_S = 1.0 / 75.0
PIECE_S = 60.0
GAIN = np.array([[0.971, 0.004, -0.022], [0.013, 1.012, -0.051], [0.031, 0.049, 0.997]])
BIAS_RAD_S = np.array([0.021, -0.050, 0.095])
TICK_HZ, SKEW, WALK_PER_SQRT_S = 1e6, -31e-6, 1e-8
BYTE_S = 10.0 / 115_200.0

# Pan and tilt in degrees and the speed in deg/s; each goes there and rests for half a second.
PROGRAM = (
    ("T", 28.0, 40.0), ("P", 110.0, 70.0), ("P", -110.0, 110.0), ("T", -44.0, 60.0),
    ("P", 0.0, 80.0), ("P", 110.0, 80.0), ("P", -110.0, 110.0), ("T", 28.0, 80.0),
    ("P", 0.0, 60.0), ("T", 0.0, 20.0), ("P", 120.0, 60.0), ("P", 0.0, 100.0),
)  # fmt: skip
REST_S = 0.5
LONG_REST_S = 6.0  # at the beginning and after every round of the program


@dataclass(slots=True)
class Axis:
    """One axis as a chain of parabolas: position, speed and acceleration from each knot on."""

    knot_s: list[float] = field(default_factory=lambda: [-1e9])
    steps: list[float] = field(default_factory=lambda: [0.0])
    speed: list[float] = field(default_factory=lambda: [0.0])
    acceleration: list[float] = field(default_factory=lambda: [0.0])

    def move(self, start_s: float, target: float, upper: float) -> float:
        """Append a trapezoid from where the axis rests; returns its end."""
        at, way = self.steps[-1], abs(target - self.steps[-1])
        sign = 1.0 if target > at else -1.0
        peak = min(upper, float(np.sqrt(BASE_STEPS_S**2 + ACCELERATION_STEPS_S2 * way)))
        ramp_s = (peak - BASE_STEPS_S) / ACCELERATION_STEPS_S2
        ramp = (peak + BASE_STEPS_S) / 2.0 * ramp_s
        flat_s = (way - 2.0 * ramp) / peak
        end_s = start_s + 2.0 * ramp_s + flat_s
        knots = (start_s, start_s + ramp_s, start_s + ramp_s + flat_s, end_s)
        self.knot_s += knots
        self.steps += [at, at + sign * ramp, at + sign * (way - ramp), target]
        self.speed += [sign * BASE_STEPS_S, sign * peak, sign * peak, 0.0]
        slope = sign * ACCELERATION_STEPS_S2
        self.acceleration += [slope, 0.0, -slope, 0.0]
        return end_s

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return position and speed at times, in steps."""
        k = np.searchsorted(self.knot_s, time_s, side="right") - 1
        t = time_s - np.asarray(self.knot_s)[k]
        v, a = np.asarray(self.speed)[k], np.asarray(self.acceleration)[k]
        return np.asarray(self.steps)[k] + t * (v + t * a / 2.0), v + t * a


def programmed(seconds: float, rng: np.random.Generator) -> tuple[dict[str, Axis], list[Command]]:
    """Return both axes' courses and the exchanges that told them, round after round."""
    axes = {"P": Axis(), "T": Axis()}
    commands: list[Command] = []
    at_s = LONG_REST_S

    def tell(text: str) -> float:
        nonlocal at_s
        asked_s, heard_s = at_s, at_s + (len(text) + 1) * BYTE_S
        at_s = heard_s + 1.5e-3 + 4 * BYTE_S + rng.exponential(2e-4)
        commands.append((asked_s, at_s, text))
        at_s += 1e-3
        return heard_s

    while True:
        for name, degrees, speed in PROGRAM:
            if at_s + 8.0 > seconds - LONG_REST_S:
                return axes, commands
            upper, target = (round(np.radians(v) / RAD_PER_STEP) for v in (speed, degrees))
            tell(f"{name}S{upper}")
            heard_s = tell(f"{name}P{target}")
            start_s = heard_s + rng.uniform(2e-3, 8e-3)
            at_s = axes[name].move(start_s, float(target), float(upper)) + REST_S
        at_s += LONG_REST_S


class Board:
    """The board's samples, minute by minute; remembers its filter, clock and line."""

    def __init__(self, axes: dict[str, Axis], rng: np.random.Generator, rate_hz: float) -> None:
        self._axes, self._rng, self._rate_hz = axes, rng, rate_hz
        b, a = butter(2, bandwidth_hz(rate_hz), fs=rate_hz * FINE)
        self._filter = (b, a)
        self._state = np.zeros((2, 3))
        self._bias = BIAS_RAD_S.copy()
        self._skew, self._ahead_s = SKEW, 0.0  # of its clock
        self._clock_s = 0.0  # when the ahead was ahead so much
        self._last_host_s = 0.0
        self.first = 0

    def ticks(self, time_s: FloatArray) -> NDArray[np.int64]:
        """Return the counter at times after the last piece, with what it has wandered."""
        shown_s = time_s + self._ahead_s + self._skew * (time_s - self._clock_s)
        return np.asarray((np.floor(shown_s * TICK_HZ).astype(np.int64) + 2**31) % 2**32, np.int64)

    def piece(self, count: int) -> dict[str, NDArray[np.int64]]:
        """Return the next samples as `write_imu_array` wants them."""
        rng, n = self._rng, count
        fine_s = (self.first * FINE + np.arange(n * FINE)) / (self._rate_hz * FINE)
        time_s = fine_s[FINE - 1 :: FINE]
        _, pan_speed = self._axes["P"].at(fine_s)
        tilt, tilt_speed = self._axes["T"].at(fine_s)
        angle = tilt * RAD_PER_STEP
        about_z = pan_speed * RAD_PER_STEP
        stage = np.column_stack(
            [tilt_speed * RAD_PER_STEP, about_z * np.sin(angle), about_z * np.cos(angle)]
        )
        noise_std = NOISE_RAD_S_RTHZ * np.sqrt(self._rate_hz * FINE / 2.0)
        white = rng.normal(size=stage.shape) * noise_std
        seen, self._state = lfilter(*self._filter, stage @ GAIN.T + white, axis=0, zi=self._state)
        walk = rng.normal(size=(n, 3)) * BIAS_WALK_RAD_S_RTS / np.sqrt(self._rate_hz)
        bias = self._bias + np.cumsum(walk, axis=0)
        self._bias = bias[-1]
        counts = np.rint((seen[FINE - 1 :: FINE] + bias) / GYRO_SCALE_RAD_S)
        lean = angle[FINE - 1 :: FINE]
        force = np.column_stack([np.zeros(n), np.sin(lean), np.cos(lean)]) * GRAVITY_M_S2
        accel = np.rint(force / ACCEL_SCALE_M_S2 + rng.normal(size=(n, 3)))
        ticks = self.ticks(time_s)
        self._wander(time_s[-1])
        late_s = rng.exponential(3e-4, n) + np.where(rng.random(n) < 5e-5, rng.uniform(0, 0.2), 0.0)
        host_s = np.maximum.accumulate(np.maximum(time_s + 1e-3 + late_s, self._last_host_s))
        self._last_host_s = float(host_s[-1])
        sequence = self.first + np.arange(n)
        self.first += n
        valid = ImuStatus.ACCEL_VALID | ImuStatus.TEMPERATURE_VALID
        return {
            "host_time_ns": START_NS + np.rint(host_s * 1e9).astype(np.int64),
            "device_time": ticks,
            "sequence": sequence,
            "status": np.full(n, int(valid | ImuStatus.STAMPED_AT_DATA_READY)),
            "temperature": np.rint(20.0 + 40.0 * -np.expm1(-time_s / 1800.0)).astype(np.int64),
            "gyro": np.clip(counts, -32768, 32767).astype(np.int64),
            "accel": accel.astype(np.int64),
        }

    def _wander(self, until_s: float) -> None:
        passed_s = until_s - self._clock_s
        self._ahead_s += self._skew * passed_s
        self._skew += float(self._rng.normal()) * WALK_PER_SQRT_S * np.sqrt(passed_s)
        self._clock_s = until_s


def poll_times(
    begin_s: float, end_s: float, commands: list[Command], rng: np.random.Generator
) -> FloatArray:
    """Return when the position is asked for, 75 times a second, not while a command is told."""
    asked_s = begin_s + POLL_S * (np.arange(int((end_s - begin_s) / POLL_S)) + 0.1)
    asked_s += rng.uniform(0.0, 2e-3, asked_s.size)
    free = np.ones(asked_s.size, dtype=np.bool_)
    for told_s, answered_s, _ in commands:
        free &= (asked_s > answered_s) | (asked_s + 0.012 < told_s)
    return np.asarray(asked_s[free], np.float64)


def polls(
    asked_s: FloatArray, axes: dict[str, Axis], first: int, rng: np.random.Generator
) -> Iterator[PtuPosition]:
    """Yield the exchanges: both axes counted in whole steps at one instant of each."""
    heard_s = asked_s + 3 * BYTE_S + 1e-4
    count_s = heard_s + rng.uniform(0.0, 2.0e-3, asked_s.size)
    first_s = count_s + 2.2e-3 + BYTE_S + rng.exponential(1e-4, asked_s.size)
    reply_s = first_s + 14 * BYTE_S
    steps = [np.floor(axes[name].at(count_s)[0] + 0.5).astype(int).tolist() for name in "PT"]
    stamps = (START_NS + np.rint(np.stack([asked_s, first_s, reply_s]) * 1e9).astype(int)).tolist()
    both = int(PtuStatus.PAN_ANSWERED | PtuStatus.TILT_ANSWERED)
    for k, (asked, begun, replied, pan, tilt) in enumerate(zip(*stamps, *steps, strict=True)):
        angles = pan * RAD_PER_STEP, tilt * RAD_PER_STEP
        yield PtuPosition(asked, begun, replied, pan, tilt, *angles, 0, first + k, both)


def ping(at_s: float, board: Board, nonce: int, rng: np.random.Generator) -> ClockPing:
    """Return one exchange of clocks, 0.5 ms and an exponential each way."""
    there_s = at_s + 5e-4 + rng.exponential(3e-4)
    back_s = there_s + 2e-4 + 5e-4 + rng.exponential(3e-4)
    received, sent = board.ticks(np.array([there_s, there_s + 2e-4])).tolist()
    stamps = [START_NS + round(t * 1e9) for t in (at_s, back_s)]
    return ClockPing(stamps[0], stamps[1], received, sent, nonce, 0)


def bandwidth_hz(rate_hz: float) -> float:
    """Return the bandwidth of the low-pass at a data rate: that of the sensor, or less."""
    return min(BANDWIDTH_HZ, 0.3 * rate_hz)


def metadata(rate_hz: float) -> dict[str, dict[str, str]]:
    """What the daemon would have written."""
    ptu = {"model": "PTU-E46-17.5", "dialect": "e46", "baud": "115200"}
    for axis, low, high in (("pan", -3090, 3090), ("tilt", -907, 604)):
        ptu |= {
            f"{axis}_resolution_arcsec": str(ARCSEC),
            f"{axis}_min_steps": str(low),
            f"{axis}_max_steps": str(high),
            f"{axis}_base_speed": f"{BASE_STEPS_S:.0f}",
            f"{axis}_upper_speed": "2902",
            f"{axis}_acceleration": f"{ACCELERATION_STEPS_S2:.0f}",
        }
    return {
        "gyrorig": {
            "session": "long", "rig": "simulated", "anchor_utc_ns": str(START_NS),
            "anchor_monotonic_raw_ns": "0",
        },
        "gyrorig.ptu": ptu,
        f"gyrorig.board.{BOARD}": {
            "uid": "10000001", "model": "GY80", "sensor": "L3G4200D", "link": "serial",
            "odr_hz": str(rate_hz), "bandwidth_hz": str(bandwidth_hz(rate_hz)),
            "gyro_full_scale_dps": "250.0", "gyro_scale_rad_s": repr(GYRO_SCALE_RAD_S),
            "accel_scale_m_s2": str(ACCEL_SCALE_M_S2), "temperature_scale_c": "0.5",
            "temperature_offset_c": "15.0", "tick_hz": str(TICK_HZ), "counter_bits": "32",
        },
    }  # fmt: skip


def write_long(path: Path, seconds: float, seed: int = 1, rate_hz: float = RATE_HZ) -> int:
    """Write a recording of so many seconds; returns its samples."""
    rng = np.random.default_rng(seed)
    axes, commands = programmed(seconds, rng)
    board = Board(axes, rng, rate_hz)
    written = count = nonce = 0
    with RecordingWriter(path, metadata(rate_hz)) as writer:
        writer.write(
            SESSION_EVENT_TOPIC, SessionEvent(START_NS, EventKind.PHASE_BEGIN, "program", "")
        )
        for begin_s in np.arange(0.0, seconds, PIECE_S).tolist():
            end_s = min(begin_s + PIECE_S, seconds)
            rows = board.piece(round(end_s * rate_hz) - board.first)
            here = [command for command in commands[written:] if command[0] < end_s]
            for asked_s, answered_s, text in here:
                asked, first, last = (
                    START_NS + round(s * 1e9) for s in (asked_s, answered_s - BYTE_S, answered_s)
                )
                exchange = PtuCommandRecord(asked, first, last, written, 0, text, "*")
                writer.write(PTU_COMMAND_TOPIC, exchange)
                written += 1
            positions = polls(poll_times(begin_s, end_s, here, rng), axes, count, rng)
            waiting = next(positions, None)
            for first in range(0, rows["sequence"].size, int(rate_hz) // 50):
                part = slice(first, first + int(rate_hz) // 50)
                row = {name: values[part] for name, values in rows.items()}
                writer.write_imu_array(BOARD, publish_time_ns=None, **row)
                now_ns = int(row["host_time_ns"][-1])
                while waiting is not None and waiting.reply_time_ns <= now_ns:
                    writer.write(PTU_POSITION_TOPIC, waiting)
                    waiting, count = next(positions, None), count + 1
                writer.tick(now_ns)
            while waiting is not None:
                writer.write(PTU_POSITION_TOPIC, waiting)
                waiting, count = next(positions, None), count + 1
            cells = np.arange(end_s, min(end_s + PIECE_S, seconds) - 0.2, 0.2)
            for at_s in (cells + rng.uniform(0.0, 0.15, cells.size)).tolist():
                writer.write(clock_ping_topic(BOARD), ping(at_s, board, nonce, rng))
                nonce += 1
        end_ns = START_NS + round(seconds * 1e9)
        writer.write(SESSION_EVENT_TOPIC, SessionEvent(end_ns, EventKind.PHASE_END, "program", ""))
    return board.first


def main() -> None:
    """Write one recording."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rate", type=float, default=RATE_HZ, help="samples per second")
    given = parser.parse_args()
    print(write_long(given.out, given.seconds, given.seed, given.rate), "samples")  # noqa: T201


if __name__ == "__main__":
    main()
