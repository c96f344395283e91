"""Lost steps: in one move the rotor falls behind the field and never catches up.

The count goes on as if nothing had happened; every angle after it is short by the lost
steps until the unit is homed. A rotor falls back by whole periods of its field, four full
steps, where it falls back freely. It happens where the torque is least: at the end of the
first ramp. Source: pan-tilt survey, section 7.
"""

import math
from collections.abc import Sequence

from gyrorig_daemon.emulator.physics.motion_law import Segment


class Slip:
    """Steps that are lost once, in the first move that begins after a time."""

    def __init__(self, steps: float, after_s: float) -> None:
        """Take the steps to lose, negative to gain, and the earliest time."""
        self._steps = steps
        self._after_s = after_s
        self.happened_s: float | None = None

    def on_move(self, segments: Sequence[Segment]) -> tuple[float, float] | None:
        """Return when and by how much the rotor shifts in a move, None where it does not."""
        begin = segments[0]
        if self.happened_s is not None or begin.start_s < self._after_s or len(segments) < 2:
            return None
        self.happened_s = segments[1].start_s
        if len(segments) == 2:  # no ramp: in the middle of the way
            self.happened_s = 0.5 * (begin.start_s + segments[1].start_s)
        direction = math.copysign(1.0, segments[-1].steps - begin.steps)
        return self.happened_s, -direction * self._steps
