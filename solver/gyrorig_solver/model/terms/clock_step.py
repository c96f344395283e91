"""The board's clock, or the host's, jumps once.

From the event on, samples were taken s earlier than stamped: t becomes t - s. A host step,
a re-enumerated USB port (about 16 ms of latency), a controller that answers longer after
its echo was switched on. Where arrival times step too, it is the clock; where they do not,
it is the unit's side or the filter.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import TimeTerm, event_times, scanned
from gyrorig_solver.model.terms.protocol import Scope, TermParameter
from gyrorig_solver.model.terms.scene import Scene

LOOKS = 40  # times over a recording from which a step is looked for


class ClockStep(TimeTerm):
    """The step and when it was."""

    cause = "clock_step"
    scope: Scope = "recording"
    parameters = (
        TermParameter("step", "s", typical=2e-3, lower=-1.0, upper=1.0, prior_std=0.1),
        TermParameter(
            "time", "s", typical=1.0, lower=-np.inf, upper=np.inf, prior_std=np.inf, role="event"
        ),
    )
    confused_with = ("lost_samples", "clock_skew", "lost_steps")
    excitation = "starts and stops before and after; sequence numbers and arrival times"
    harm = "the time offset holds for a part of the recording; scale and M hardly move"

    def delay(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return -s after the event, (instants,)."""
        return -float(values[0]) * after(scene, float(values[1]))

    def delay_columns(self, scene: Scene, values: FloatArray) -> dict[int, FloatArray]:
        """Return -1 after the event."""
        return {0: -after(scene, float(values[1]))}

    def bank(self, scene: Scene) -> FloatArray:
        """Look from times all over the recording, for small steps and for large ones."""
        return scanned(self, step=np.array([-0.05, 0.0, 0.05]), time=event_times(scene, LOOKS))

    def sentence(self, values: FloatArray) -> str:
        """Say step and time."""
        return f"the stamps jump by {values[0] * 1e3:.3g} ms at {values[1]:.1f} s"


def after(scene: Scene, event_s: float) -> FloatArray:
    """Return 0 before an event and 1 from it on, (instants,), in between over one period."""
    period_s = scene.fine * scene.step_s
    return np.clip((scene.instants_s - event_s) / period_s + 0.5, 0.0, 1.0)


TERM = ClockStep()
