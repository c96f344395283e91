"""Board slip: the board turns on the stage once, for example because a screw loosens.

The turn takes no time here, so that it adds no rate.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    Cause,
    FloatArray,
    InjectedCause,
    ParameterSampling,
    Quantity,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks
from gyrorig_daemon.emulator.physics.rotation import rotation_matrix


@dataclass(frozen=True, slots=True, eq=False)
class BoardSlip(Cause):
    """The mounting M becomes R M from an instant on."""

    name = "board_slip"
    size_meaning = "angle by which the board turns once on the stage"
    part = "mount"
    unit = "rad"
    typical = 5e-3
    sampled_min, sampled_max = 1.7e-3, 1.7e-2
    max_size = 0.5
    is_signed = False

    rotation: FloatArray  # R, (3, 3)
    at_s: float

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        axis = sampling.rng.standard_normal(3)
        turn = sampling.size * axis / np.linalg.norm(axis)
        return {
            "turn": Quantity(tuple(turn.tolist()), "rad"),
            "at": Quantity(sampling.event_s(), "s"),
        }

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`."""
        turn = np.array(stated.by_sensor_axis("turn", "rad").value)
        # Findings turn the rate about axes of the stage, the other way round.
        in_sensor = -stated.on_board.mounting @ turn
        return (
            CarriedCause(
                {"turn": Quantity(tuple(in_sensor.tolist()), "rad"), "at": stated.event_s()}
            ),
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        slip = cls(rotation_matrix(injected.array("turn")), injected.number("at"))
        injected.board_hooks(hooks).mount_effects.append(slip)

    def turned(self, time_s: FloatArray, vectors: FloatArray) -> FloatArray:
        """See `board_effects.MountEffect`."""
        return np.where((time_s >= self.at_s)[:, None], vectors @ self.rotation.T, vectors)
