"""Settings and true parameters of the devices of a twin, without its causes."""

from dataclasses import replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.board.emulated_board import BUS_READ_NS
from gyrorig_daemon.emulator.board.emulated_protocol import find_emulated_protocol
from gyrorig_daemon.emulator.emulated_line import byte_ns
from gyrorig_daemon.emulator.emulator_settings import BoardSettings, PtuSettings
from gyrorig_daemon.emulator.physics.device_clock import ClockTruth
from gyrorig_daemon.emulator.physics.host_latency import LatencyTruth
from gyrorig_daemon.emulator.physics.imu import ImuTruth
from gyrorig_daemon.emulator.physics.lowpass import butterworth_delay_s
from gyrorig_daemon.emulator.physics.rotation import rotation_matrix
from gyrorig_daemon.emulator.physics.temperature import BoardTemperature, TemperatureCurve
from gyrorig_daemon.emulator.rig_truth import (
    ACCEL_COUNTS_PER_G,
    COUNTER_MODULUS,
    DEG,
    GYRO_MDPS_PER_COUNT,
    BoardTruth,
)
from gyrorig_protocol.board.board_frames import Sample, TimeReply, TimeRequest
from gyrorig_protocol.twin import (
    Scalar,
    TwinBoard,
    TwinClock,
    TwinLink,
    TwinUnit,
    UnitFacts,
    Vector,
)

FloatArray = NDArray[np.float64]

# The middle of what a rig samples, for what a twin does not state; see `rig_truth`.
_NOISE_DENSITY_RAD_S_RTHZ = 0.03 * DEG
_BIAS_INSTABILITY_RAD_S = 30.0 * DEG / 3600.0
_RATE_RANDOM_WALK = 0.3e-3 * DEG
_WANDER_PER_RTS = 1e-8
_AMBIENT_DEGC, _SELF_HEATING_K, _WARM_UP_S = 23.0, 2.5, 300.0
_FULL_STEP_RATIO = 2.0  # full steps over steps, in the mode H
_COUNTS_OF_FULL_SCALE = 32768.0


def _number(quantity: Scalar | None, default: float) -> float:
    return default if quantity is None else quantity.value


def _array(quantity: Vector | None, default: float) -> FloatArray:
    return np.full(3, default) if quantity is None else np.array(quantity.value)


def unit_settings(unit: TwinUnit | None, ptu: PtuSettings) -> PtuSettings:
    """Return the settings of a unit with what the twin states of it."""
    if unit is None:
        return ptu
    answer_s = max(_number(unit.answer_time, ptu.command_time_ms * 1e-3), 1e-6)
    read_s = answer_s * ptu.sample_fraction
    start_s = _number(unit.start_delay, read_s)
    facts = {
        name: value
        for name in UnitFacts.__struct_fields__
        if (value := getattr(unit.facts, name)) is not None
    }
    resolution_arcsec = facts.pop("resolution_arcsec", None)
    if resolution_arcsec is not None:
        facts |= {"step_mode": "H", "full_step_arcsec": _FULL_STEP_RATIO * resolution_arcsec}
    return replace(
        ptu,
        command_time_ms=answer_s * 1e3,
        start_delay_ms=(start_s - read_s) * 1e3,  # `starting_earlier` limits it
        **facts,
    )


def starting_earlier(ptu: PtuSettings, start_delay_s: float) -> PtuSettings:
    """Return a unit whose moves start earlier, at most with the last byte of their command."""
    earliest_ms = -ptu.command_time_ms * ptu.sample_fraction
    return replace(ptu, start_delay_ms=max(ptu.start_delay_ms - start_delay_s * 1e3, earliest_ms))


def board_settings(board: TwinBoard, settings: BoardSettings) -> BoardSettings:
    """Return the settings of a board with what the twin states of it."""
    settings = replace(settings, bandwidth_hz=_number(board.bandwidth, settings.bandwidth_hz))
    if board.full_scale is not None:
        settings = replace(settings, full_scale_dps=round(board.full_scale.value / DEG, 6))
    if board.count is not None:
        # HELLO has six decimals of deg/s per count.
        settings = replace(settings, count_mdps=round(board.count.value / DEG, 6) * 1e3)
    elif settings.full_scale_dps not in GYRO_MDPS_PER_COUNT:
        settings = replace(
            settings, count_mdps=round(settings.full_scale_dps / _COUNTS_OF_FULL_SCALE, 6) * 1e3
        )
    return settings


def in_recording(board: TwinBoard, recording: str) -> TwinBoard:
    """Return a board with its temperature in a recording, that of the first one if it has none."""
    later = board.later_temperatures.get(recording)
    return board if later is None else msgspec.structs.replace(board, temperature=later)


def base_truth(
    board: TwinBoard, settings: BoardSettings, sampled: BoardTruth, zero_s: float
) -> BoardTruth:
    """Return the truth of a board without causes; its delay follows later.

    Args:
        board: what the twin states.
        settings: of the board, as `board_settings` returns them.
        sampled: start of its clock, and values that no twin states.
        zero_s: the zero of the twin's times, since power-up.
    """
    gain = np.array(board.gain.value)
    imu: ImuTruth = replace(
        sampled.imu,
        odr_hz=_number(board.odr, settings.odr_hz),
        bandwidth_hz=settings.bandwidth_hz,
        bias_rad_s=np.array(board.bias.value),
        noise_density_rad_s_rthz=_array(board.noise_density, _NOISE_DENSITY_RAD_S_RTHZ),
        bias_instability_rad_s=_array(board.bias_instability, _BIAS_INSTABILITY_RAD_S),
        rate_random_walk=_array(board.rate_random_walk, _RATE_RANDOM_WALK),
        noise_floor_rad_s_rthz=_array(board.noise_floor, 0.0),
        accel_gain=np.ones(3),
        accel_bias_m_s2=np.zeros(3),
        ambient_degc=_AMBIENT_DEGC,
        self_heating_k=_SELF_HEATING_K,
        warm_up_s=_WARM_UP_S,
        temperature_curve=_temperature_curve(board, zero_s),
    )
    return _with_gain(
        BoardTruth(
            imu=imu,
            scale=np.eye(3),
            nonorthogonality=np.eye(3),
            clock=clock_truth(board.clock, sampled.clock),
            stamp_jitter_s=max(_number(board.stamp_jitter, sampled.stamp_jitter_s), 0.0),
        ),
        gain,
    )


def reference_rise_k(board: TwinBoard, imu: ImuTruth, session_s: tuple[float, float]) -> float:
    """Return the reference temperature of thermal causes minus that at power-up.

    Args:
        board: what the twin states.
        imu: the truth of the board.
        session_s: begin and end of the session, since power-up.
    """
    model = BoardTemperature(
        imu.ambient_degc, imu.self_heating_k, imu.warm_up_s, 0.0, curve=imu.temperature_curve
    )
    stated = None if board.temperature is None else board.temperature.reference_degc
    if stated is None:
        stated = float(model.degc(np.linspace(*session_s, 201)).mean())
    return stated - model.power_up_degc


def link_delay_s(settings: BoardSettings, truth: BoardTruth, latency: LatencyTruth) -> float:
    """Return the part of a fitted time offset that the link of a board causes.

    A host maps the clock of a board by exchanges, and is wrong by half the difference of the two
    shortest latencies. Without exchanges, it is wrong by the shortest latency of a sample, which is
    that of a sample at rest if its length depends on its numbers.
    """
    if settings.bus:
        return 0.0  # the edge of a frame is one event for both
    protocol = find_emulated_protocol(settings.format)
    byte_s = byte_ns(settings.baud) * 1e-9
    if protocol.make_parser() is None:
        x, y, z = np.rint(truth.imu.bias_rad_s / truth.imu.gyro_scale_rad_s).astype(int).tolist()
        ticks = truth.clock.start_ticks % COUNTER_MODULUS
        sample = Sample(0, 1, ticks, (x, y, z), (0, 0, round(ACCEL_COUNTS_PER_G)), 250)
        sample_bytes = len(protocol.encode(sample, settings))
        return BUS_READ_NS * 1e-9 + sample_bytes * byte_s + latency.floor_s
    request_bytes = len(TimeRequest(1, 1).encode())
    reply_bytes = len(protocol.encode(TimeReply(1, 1, 1, 1), settings))
    difference_s = (reply_bytes - request_bytes) * byte_s
    return 0.5 * (difference_s + latency.floor_s - latency.write_floor_s)


def unit_lag_s(latency: LatencyTruth) -> float:
    """Return the part of a fitted time offset that the line of the unit causes.

    A fit assumes that a count was read in the middle of the shortest time of an exchange. The error
    is half the difference of the latency floors of reading and writing. If the fitted motion is
    late by this time, the boards appear early by the same time.
    """
    return 0.5 * (latency.write_floor_s - latency.floor_s)


def _temperature_curve(board: TwinBoard, zero_s: float) -> TemperatureCurve | None:
    if board.temperature is None:
        return None
    times_s = tuple(zero_s + time_s for time_s in board.temperature.time_s)
    return TemperatureCurve(times_s, tuple(board.temperature.degc))


def _with_gain(board: BoardTruth, gain: FloatArray) -> BoardTruth:
    """Return a board with another gain, with its factors S, T and a rotation M.

    A mirrored gain has a negative scale on the axis for which M is nearest to the identity.
    """
    q, r = np.linalg.qr(gain.T)
    signs = np.sign(np.diagonal(r))
    lower, mounting = r.T * signs, signs[:, None] * q.T
    if np.linalg.det(mounting) < 0.0:
        flip = np.ones(3)
        flip[int(np.argmin(np.diagonal(mounting)))] = -1.0
        lower, mounting = lower * flip, flip[:, None] * mounting
    scale = np.diagonal(lower)
    return replace(
        board,
        imu=replace(board.imu, gain=gain, mounting=mounting),
        scale=np.diag(scale),
        nonorthogonality=lower / scale[:, None],
    )


def without_turn(board: BoardTruth, turn_rad: FloatArray) -> BoardTruth:
    """Return a board whose fitted gain contains a rotation of the stage, without it."""
    return _with_gain(board, board.imu.gain @ rotation_matrix(turn_rad).T)


def with_delay(board: BoardTruth, delay_s: float) -> BoardTruth:
    """Return a board with a total delay, with that of the low-pass and without that of the link.

    Samples cannot be earlier than the motion, therefore early ones have early timestamps.
    """
    tau_s = delay_s - butterworth_delay_s(board.imu.bandwidth_hz)
    return replace(
        board,
        imu=replace(board.imu, tau_s=max(tau_s, 0.0)),
        stamp_early_s=max(-tau_s, 0.0),
    )


def clock_truth(clock: TwinClock | None, sampled: ClockTruth) -> ClockTruth:
    """Return the truth of a clock; `sampled` has its start."""
    if clock is None:
        return replace(sampled, skew=0.0, wander_per_rts=_WANDER_PER_RTS)
    return replace(
        sampled,
        tick_hz=clock.tick_hz or sampled.tick_hz,
        skew=_number(clock.skew, 0.0),
        wander_per_rts=max(_number(clock.wander, _WANDER_PER_RTS), 0.0),
    )


def latency_truth(link: TwinLink) -> LatencyTruth:
    """Return the latency of the host."""
    values = {
        f"{name}_s": max(quantity.value, 0.0)
        for name in TwinLink.__struct_fields__
        if (quantity := getattr(link, name)) is not None
    }
    latency = replace(LatencyTruth(), **values)
    return replace(latency, stall_longest_s=max(latency.stall_longest_s, latency.stall_shortest_s))
