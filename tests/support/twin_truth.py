"""A twin against the truth of the emulated rig that was recorded.

What to use when: `compare_twin` for the twin of a recording that was made with `--truth`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gyrorig_protocol.twin import Scalar, Twin, TwinBoard, TwinUnit, Vector

JITTER_S, SHORTEST_STALL_S, LONGEST_STALL_S = 0.3e-3, 5e-3, 0.2  # of the emulated host
STALL_INTERVAL_S = 20.0
MAX_NOISE_ERROR = 0.15  # of a density


@dataclass(frozen=True, slots=True)
class Deviation:
    """A value of a twin, its truth, and the difference in standard deviations."""

    name: str
    value: float
    truth: float
    sigma: float


def compare_twin(
    twin: Twin, truth: Mapping[str, Any], command_time_s: float
) -> Iterator[Deviation]:
    """Yield the deviation of each measured value from the truth.

    Args:
        twin: of a recording of an emulated rig.
        truth: as `gyrorigd record --truth` writes it.
        command_time_s: processing time of the emulated controller.
    """
    for board_id, board in twin.boards.items():
        yield from _board(f"{board_id} ", board, truth["boards"][board_id])
    if twin.unit is not None:
        yield from _unit(twin.unit, truth["controller_clock"], command_time_s)
    for name, true_s in (
        ("floor", truth["host_latency_floor_s"]),
        ("jitter", JITTER_S),
        ("stall_shortest", SHORTEST_STALL_S),
        ("stall_longest", LONGEST_STALL_S),
    ):
        value = getattr(twin.link, name)
        if value is not None and value.std is not None:
            yield _scalar(name, value, true_s)
    interval = twin.link.stall_interval
    if interval is not None:
        span_s = sum(r.end_s - r.begin_s for r in twin.recordings)
        expected = span_s / STALL_INTERVAL_S
        seen = span_s / interval.value if interval.value > 0.0 else 0.0
        yield _deviation("stalls", seen, expected, np.sqrt(expected))


def _board(place: str, board: TwinBoard, true: Mapping[str, Any]) -> Iterator[Deviation]:
    gain, std = np.array(board.gain.value), np.array(board.gain.std)
    for k, true_gain in np.ndenumerate(np.array(true["STM"])):
        yield _deviation(f"{place}gain {k}", float(gain[k]), float(true_gain), float(std[k]))
    yield from _vector(f"{place}bias", board.bias, true["mean_bias_rad_s"])
    low_pass_s = np.sqrt(0.5) / (np.pi * true["low_pass"]["cutoff_hz"])
    yield _scalar(f"{place}time offset", board.time_offset, true["tau_s"] + low_pass_s)
    if board.noise_density is not None:
        densities = true["noise_density_rad_s_rthz"]
        for value, density in zip(board.noise_density.value, densities, strict=True):
            # 15 % are four of these.
            yield _deviation(f"{place}noise", value, density, MAX_NOISE_ERROR * density / 4.0)
    if board.odr is not None:
        yield _scalar(f"{place}odr", board.odr, true["odr_hz"])
    if board.clock.skew is not None:
        yield _scalar(f"{place}skew", board.clock.skew, true["clock"]["skew_ppm"] * 1e-6)


def _unit(
    unit: TwinUnit, true_clock: Mapping[str, float], command_time_s: float
) -> Iterator[Deviation]:
    if unit.counter.skew is not None:
        yield _scalar("counter skew", unit.counter.skew, true_clock["skew_ppm"] * 1e-6)
    if unit.answer_time is not None:
        yield _scalar("answer time", unit.answer_time, command_time_s)
    if unit.start_delay is not None:
        yield _scalar("start delay", unit.start_delay, command_time_s / 2.0)


def _vector(name: str, vector: Vector, truth: list[float]) -> Iterator[Deviation]:
    assert vector.std is not None
    for k, (value, std) in enumerate(zip(vector.value, vector.std, strict=True)):
        yield _deviation(f"{name} {'xyz'[k]}", value, truth[k], std)


def _scalar(name: str, scalar: Scalar, truth: float) -> Deviation:
    assert scalar.std is not None, name
    return _deviation(name, scalar.value, truth, scalar.std)


def _deviation(name: str, value: float, truth: float, std: float) -> Deviation:
    return Deviation(name, float(value), float(truth), float((value - truth) / std))
