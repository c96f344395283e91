"""A gyroscope's noise, quantum, output rate and low-pass from its data sheet."""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.profile import SensorProfile
from gyrorig_protocol.profile.sensor_profile import FullScaleRange
from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import NoiseModel, Sampling, choose_grids, nominal_levels


@dataclass(frozen=True, slots=True, eq=False)
class SensorModel:
    """The sensor and link properties that determine the uncertainties."""

    name: str
    odr_hz: float
    bandwidth_hz: float | None
    quantum_rad_s: float
    full_scale_rad_s: float
    levels: FloatArray  # (3, 4), squares: N^2, B^2, K^2, D^2 as in `NoiseModel`
    timestamp_std_s: float  # of one shift that is common to all sample times

    @property
    def noise(self) -> NoiseModel:
        """The noise of the block means that the solver fits."""
        block, _ = choose_grids(self.odr_hz, self.bandwidth_hz)
        sampling = Sampling(
            rate_hz=self.odr_hz / block,
            samples_per_block=block,
            bandwidth_hz=self.bandwidth_hz,
            quantum_rad_s=self.quantum_rad_s,
            differentiated=False,
        )
        return NoiseModel(self.levels, sampling)


def build_sensor_model(
    profile: SensorProfile,
    odr_hz: float | None = None,
    bandwidth_hz: float | None = None,
    full_scale_dps: float | None = None,
    timestamp_std_s: float = 0.0,
) -> SensorModel:
    """Return the model of a sensor from its data sheet, with typical settings by default.

    The default output rate is the lowest of the data sheet. The default bandwidth is the widest at
    that rate. The default full scale is the smallest that measures 250 deg/s.

    Args:
        profile: the data sheet. No data sheet gives flicker and random walk; the model uses those
            of an ordinary part with the same noise density.
        odr_hz: output data rate.
        bandwidth_hz: of the low-pass.
        full_scale_dps: the configured full scale.
        timestamp_std_s: standard uncertainty of one shift that is common to all sample times.

    Raises:
        UsageError: the data sheet has no noise density or not this full scale.
    """
    if profile.noise_density_dps_rthz is None:
        raise UsageError(
            "the prediction needs the noise density, but the profile of the sensor "
            f"{profile.sensor} has no noise_density_dps_rthz",
            "add the value of the data sheet to the profile, in deg/s/sqrt(Hz)",
        )
    if odr_hz is None:
        odr_hz = min((entry.odr_hz for entry in profile.low_pass), default=100.0)
    if bandwidth_hz is None:
        fitting = [e.bandwidth_hz for e in profile.low_pass if e.odr_hz == odr_hz]
        bandwidth_hz = max(fitting[0]) if fitting and fitting[0] else None
    density = float(np.radians(profile.noise_density_dps_rthz))
    chosen = _select_range(profile, full_scale_dps)
    return SensorModel(
        name=profile.sensor,
        odr_hz=odr_hz,
        bandwidth_hz=bandwidth_hz,
        quantum_rad_s=float(np.radians(chosen.sensitivity_mdps * 1e-3)),
        full_scale_rad_s=float(np.radians(chosen.full_scale_dps)),
        levels=np.tile(nominal_levels(density**2), (3, 1)),
        timestamp_std_s=timestamp_std_s,
    )


def _select_range(profile: SensorProfile, full_scale_dps: float | None) -> FullScaleRange:
    wanted = full_scale_dps or min(
        (r.full_scale_dps for r in profile.ranges if r.full_scale_dps >= 250.0), default=250.0
    )
    chosen = next((r for r in profile.ranges if r.full_scale_dps == wanted), None)
    if chosen is None:
        available = ", ".join(f"{r.full_scale_dps:g}" for r in profile.ranges)
        raise UsageError(
            f"the profile of the sensor {profile.sensor} has no full scale of {wanted:g} deg/s",
            f"set the board's full scale in the rig file to one of {available}",
        )
    return chosen
