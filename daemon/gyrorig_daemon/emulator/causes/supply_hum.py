"""Supply hum: A sin(2 pi f t + p) at the mains frequency, folded by the sampling."""

import math
from dataclasses import dataclass, field

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    FloatArray,
    InjectedCause,
    ParameterSampling,
    Quantity,
    SensorCause,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks
from gyrorig_daemon.emulator.physics.temperature import BoardTemperature

_MAINS_HZ = (50.0, 60.0)
_MAINS_SPREAD = 1e-3  # relative deviation of the mains frequency on a usual day


@dataclass(frozen=True, slots=True, eq=False)
class SupplyHum(SensorCause):
    """A sine at the mains frequency adds to the samples."""

    name = "supply_hum"
    size_meaning = "largest amplitude of the hum"
    unit = "rad/s"
    typical = 1e-3
    sampled_min, sampled_max = 3e-4, 5e-3
    max_size = 0.5
    is_signed = False

    amplitude_rad_s: FloatArray  # (3,)
    frequency_hz: float
    phase_rad: float
    # Amplitude of the cosine, (3,); then `amplitude_rad_s` is that of the sine.
    cosine_rad_s: FloatArray = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        mains_hz = float(sampling.rng.choice(_MAINS_HZ))
        mains_hz *= 1.0 + _MAINS_SPREAD * float(sampling.rng.uniform(-1.0, 1.0))
        return {
            "amplitude": sampling.by_axis("rad/s"),
            "frequency": Quantity(mains_hz, "Hz"),
            "phase": Quantity(sampling.phase_rad(), "rad"),
        }

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`."""
        frequency_hz = stated.number("frequency")
        # Findings count the phase from the begin of the recording.
        periods = frequency_hz * stated.begin_s + stated.period_share
        phase_rad = math.remainder(-2.0 * math.pi * periods, 2.0 * math.pi)
        return (
            CarriedCause(
                {
                    "amplitude": stated.by_sensor_axis("sine", "rad/s"),
                    "frequency": Quantity(frequency_hz, "Hz"),
                    "phase": Quantity(phase_rad, "rad"),
                    "cosine": stated.by_sensor_axis("cosine", "rad/s"),
                }
            ),
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        effect = cls(
            injected.array("amplitude"),
            injected.number("frequency"),
            injected.number("phase"),
            injected.array_or_zeros("cosine"),
        )
        injected.board_hooks(hooks).bias_effects.append(effect)

    def added_rad_s(self, time_s: FloatArray, temperature: BoardTemperature) -> FloatArray:
        """See `board_effects.BiasEffect`."""
        phase = 2.0 * math.pi * self.frequency_hz * time_s + self.phase_rad
        added = np.outer(np.sin(phase), self.amplitude_rad_s)
        return (
            added + np.outer(np.cos(phase), self.cosine_rad_s) if self.cosine_rad_s.any() else added
        )
