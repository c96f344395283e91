"""Samples are lost that nobody counted: what comes after is stamped too early.

Where stamps come from counting samples, n lost ones shift all later labels by n periods:
true time t + n Ts from the event on. A clock step of a whole number of periods; the board's
own stamps or sequence numbers tell one from the other.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import TimeTerm, event_times, scanned
from gyrorig_solver.model.terms.clock_step import LOOKS, after
from gyrorig_solver.model.terms.protocol import Scope, TermParameter
from gyrorig_solver.model.terms.scene import Scene


class LostSamples(TimeTerm):
    """How many, and when."""

    cause = "lost_samples"
    scope: Scope = "recording"
    parameters = (
        TermParameter(
            "count",
            "samples",
            typical=3.0,
            lower=0.0,
            upper=1000.0,
            prior_std=100.0,
            whole=True,
        ),
        TermParameter(
            "time", "s", typical=1.0, lower=-np.inf, upper=np.inf, prior_std=np.inf, role="event"
        ),
    )
    confused_with = ("clock_step", "clock_skew")
    excitation = "sequence numbers; without them starts and stops before and after"
    harm = "the time offset holds for a part of the recording"

    def missing(self, scene: Scene) -> str | None:
        """Say that the sample period is not known."""
        if scene.setting.sample_period_s is None:
            return "the sample period is not known; record the board's odr_hz"
        return None

    def delay(self, scene: Scene, values: FloatArray) -> FloatArray:
        """Return n periods after the event, (instants,)."""
        return float(values[0]) * self._period(scene) * after(scene, float(values[1]))

    def delay_columns(self, scene: Scene, values: FloatArray) -> dict[int, FloatArray]:
        """Return one period after the event."""
        return {0: self._period(scene) * after(scene, float(values[1]))}

    def bank(self, scene: Scene) -> FloatArray:
        """Look from times all over the recording, for a few and for many."""
        return scanned(self, count=np.array([0.0, 20.0]), time=event_times(scene, LOOKS))

    def sentence(self, values: FloatArray) -> str:
        """Say how many and when."""
        return f"{values[0]:.3g} samples are missing uncounted at {values[1]:.1f} s"

    def _period(self, scene: Scene) -> float:
        return scene.setting.sample_period_s or 0.0


TERM = LostSamples()
