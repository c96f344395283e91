"""True parameters of a rig, sampled once from a seed and hidden from clients.

`sample_rig_truth` returns the truth of a rig; `RigTruth.to_document` returns it as plain values, to
compare with a solver's results. The spreads are those of the parts: L3G4200D (values of its sister
part I3G4250D: scale +-15 %, zero rate +-10 dps, 0.03 dps/sqrt(Hz), output data rate 105 Hz instead
of the nominal 100), crystal clocks, a board that was mounted by hand.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.emulator_settings import BoardSettings, PtuSettings, RigSettings
from gyrorig_daemon.emulator.injection import InjectedCause, apply_causes, sample_injected_causes
from gyrorig_daemon.emulator.physics.device_clock import ClockTruth
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks
from gyrorig_daemon.emulator.physics.host_latency import LatencyTruth
from gyrorig_daemon.emulator.physics.imu import ImuTruth
from gyrorig_daemon.emulator.physics.rotation import rotation_matrix

FloatArray = NDArray[np.float64]

DEG = math.pi / 180.0
STANDARD_GRAVITY_M_S2 = 9.80665

# Sensitivity by full scale, I3G4250D data sheet: 8.75, 17.5, 70 mdps per count.
GYRO_MDPS_PER_COUNT = {250.0: 8.75, 500.0: 17.5, 2000.0: 70.0}
ACCEL_COUNTS_PER_G = 256.0  # ADXL345, full resolution
COUNTER_MODULUS = 2**32


@dataclass(frozen=True, slots=True, eq=False)
class BoardTruth:
    """One board: its sensor, with the letters of the paper, and its clock."""

    imu: ImuTruth
    scale: FloatArray  # S, diagonal, (3, 3)
    nonorthogonality: FloatArray  # T, unit lower triangular, (3, 3)
    clock: ClockTruth
    stamp_jitter_s: float  # mean of the interrupt's exponential delay
    stamp_early_s: float = 0.0  # by which each timestamp is too early

    def to_document(self) -> dict[str, Any]:
        """Return plain values with units in the names."""
        imu = self.imu
        document = {
            "scale": self.scale.diagonal().tolist(),
            "T": self.nonorthogonality.tolist(),
            "M": imu.mounting.tolist(),
            "STM": imu.gain.tolist(),
            "bias_rad_s": imu.bias_rad_s.tolist(),
            "noise_density_rad_s_rthz": imu.noise_density_rad_s_rthz.tolist(),
            "bias_instability_rad_s": imu.bias_instability_rad_s.tolist(),
            "rate_random_walk_rad_s_rts": imu.rate_random_walk.tolist(),
            "tau_s": imu.tau_s,
            "low_pass": {"kind": "butterworth", "order": 2, "cutoff_hz": imu.bandwidth_hz},
            "odr_hz": imu.odr_hz,
            "gyro_scale_rad_s": imu.gyro_scale_rad_s,
            "accel_gain": imu.accel_gain.tolist(),
            "accel_bias_m_s2": imu.accel_bias_m_s2.tolist(),
            "clock": _clock_document(self.clock),
        }
        if imu.noise_floor_rad_s_rthz.any():
            document["noise_floor_rad_s_rthz"] = imu.noise_floor_rad_s_rthz.tolist()
        return document


@dataclass(frozen=True, slots=True, eq=False)
class RigTruth:
    """The true parameters of a rig."""

    seed: int
    pan_scale_error: float
    tilt_scale_error: float
    tilt_axis_error_rad: float
    controller_clock: ClockTruth
    latency: LatencyTruth
    boards: Mapping[str, BoardTruth]
    injected: tuple[InjectedCause, ...] = ()

    def to_document(self) -> dict[str, Any]:
        """Return plain values with units in the names; `hidden` only with injected causes."""
        document: dict[str, Any] = {
            "seed": self.seed,
            "note": "y = STM omega(t - tau_s) through the low-pass + bias; STM = S T M",
            "pan_scale_error": self.pan_scale_error,
            "tilt_scale_error": self.tilt_scale_error,
            "tilt_axis_error_rad": self.tilt_axis_error_rad,
            "controller_clock": _clock_document(self.controller_clock),
            "host_latency_floor_s": self.latency.floor_s,
            "boards": {name: board.to_document() for name, board in self.boards.items()},
        }
        if self.injected:
            document["hidden"] = {"causes": [cause.to_document() for cause in self.injected]}
        return document

    def with_hooks(self, hooks: RigHooks) -> "RigTruth":
        """Return the truth with the causes that change one of its values."""
        boards = dict(self.boards)
        for name, board_hooks in hooks.boards.items():
            imu = boards[name].imu
            imu = replace(
                imu,
                tau_s=imu.tau_s + board_hooks.tau_added_s,
                bandwidth_hz=imu.bandwidth_hz * board_hooks.bandwidth_factor,
            )
            boards[name] = replace(boards[name], imu=imu)
        return replace(
            self,
            pan_scale_error=self.pan_scale_error + hooks.pan.scale_error,
            tilt_scale_error=self.tilt_scale_error + hooks.tilt.scale_error,
            tilt_axis_error_rad=self.tilt_axis_error_rad + hooks.tilt_axis_error_rad,
            boards=boards,
        )


def sample_rig_truth(settings: RigSettings) -> RigTruth:
    """Return the truth of a rig, a pure function of its settings.

    Raises:
        UsageError: an injection is invalid; see `causes.sample_injected_causes`.
    """
    root = np.random.SeedSequence(settings.seed)
    ptu_seed, *board_seeds = root.spawn(1 + len(settings.boards))
    rng = np.random.default_rng(ptu_seed)
    unit_settings = settings.ptu or PtuSettings()
    injected = sample_injected_causes(settings)
    base = RigTruth(
        seed=settings.seed,
        pan_scale_error=0.0,
        tilt_scale_error=0.0,
        tilt_axis_error_rad=0.0,
        controller_clock=ClockTruth(
            tick_hz=unit_settings.counter_hz,
            skew=float(rng.uniform(-50e-6, 50e-6)),
            wander_per_rts=1e-8,
            start_ticks=int(rng.integers(0, 2**unit_settings.counter_bits)),
        ),
        latency=LatencyTruth(),
        boards={
            board.name: sample_board_truth(board, np.random.default_rng(seed))
            for board, seed in zip(settings.boards, board_seeds, strict=True)
        },
        injected=injected,
    )
    return base.with_hooks(apply_causes(injected, settings.seed, settings.session_seed))


def mdps_per_count(settings: BoardSettings) -> float:
    """Return the nominal rate per count of the gyroscope."""
    return settings.count_mdps or GYRO_MDPS_PER_COUNT[settings.full_scale_dps]


def sample_board_truth(settings: BoardSettings, rng: np.random.Generator) -> BoardTruth:
    """Return one board's truth."""
    scale = np.diag(1.0 + rng.uniform(-0.05, 0.05, 3))
    nonorthogonality = np.eye(3)
    nonorthogonality[np.tril_indices(3, -1)] = rng.uniform(-1.0, 1.0, 3) * DEG
    mounting = rotation_matrix(rng.normal(0.0, 0.03, 3))
    bias = rng.uniform(0.02, 0.1, 3) * rng.choice((-1.0, 1.0), 3)
    imu = ImuTruth(
        odr_hz=settings.odr_hz * (1.0 + float(rng.uniform(-0.03, 0.05))),
        bandwidth_hz=settings.bandwidth_hz,
        gain=scale @ nonorthogonality @ mounting,
        mounting=mounting,
        bias_rad_s=bias,
        noise_density_rad_s_rthz=0.03 * DEG * rng.uniform(0.75, 1.25, 3),
        # 20 to 40 deg/h, usual for parts of this kind.
        bias_instability_rad_s=rng.uniform(20.0, 40.0, 3) * DEG / 3600.0,
        rate_random_walk=0.3e-3 * DEG * rng.uniform(0.5, 1.5, 3),
        tau_s=float(rng.uniform(0.1, 0.6)) / settings.odr_hz,
        gyro_scale_rad_s=mdps_per_count(settings) * 1e-3 * DEG,
        gyro_limit_rad_s=settings.full_scale_dps * DEG,
        accel_scale_m_s2=STANDARD_GRAVITY_M_S2 / ACCEL_COUNTS_PER_G,
        accel_gain=1.0 + rng.uniform(-0.02, 0.02, 3),
        # ADXL345 zero-g offset +-40 mg on x, y; about 1 count rms of noise.
        accel_bias_m_s2=STANDARD_GRAVITY_M_S2 * rng.uniform(-0.04, 0.04, 3),
        accel_noise_m_s2=STANDARD_GRAVITY_M_S2 / ACCEL_COUNTS_PER_G,
        ambient_degc=float(rng.uniform(18.0, 28.0)),
        self_heating_k=float(rng.uniform(1.0, 4.0)),
        warm_up_s=float(rng.uniform(120.0, 600.0)),
    )
    return BoardTruth(imu, scale, nonorthogonality, _sample_board_clock(rng), stamp_jitter_s=2e-6)


def _sample_board_clock(rng: np.random.Generator) -> ClockTruth:
    """Sample a crystal clock; every other one wraps its 32 bits within two minutes."""
    start = int(rng.integers(0, COUNTER_MODULUS))
    start_before_wrap = COUNTER_MODULUS - int(rng.integers(5_000_000, 120_000_000))
    return ClockTruth(
        tick_hz=1e6,
        skew=float(rng.uniform(-50e-6, 50e-6)),
        wander_per_rts=1e-8,
        start_ticks=start_before_wrap if rng.random() < 0.5 else start,
    )


def _clock_document(clock: ClockTruth) -> dict[str, Any]:
    return {
        "tick_hz": clock.tick_hz,
        "skew_ppm": clock.skew * 1e6,
        "wander_ppm_per_rts": clock.wander_per_rts * 1e6,
        "start_ticks": clock.start_ticks,
    }
