"""Samples come twice: the sensor was asked faster than it had new ones.

y_k = y_{k-1}, all three words alike to the bit; a BMI088 published 1250 a second of which
1000 were fresh. Seen in the raw counts: with noise of more than one count a true repeat of
three words is rare. In the mean it is a lag of share/2 periods, part of the time offset.
"""

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import UnseenTerm
from gyrorig_solver.model.terms.protocol import Kind, Part, Scope, TermParameter


class RepeatedSamples(UnseenTerm):
    """The share of samples that repeat the one before."""

    cause = "repeated_samples"
    part: Part = "clock"
    kind: Kind = "raw"
    scope: Scope = "recording"
    parameters = (TermParameter("share", "1", typical=0.1, lower=0.0, upper=1.0, prior_std=1.0),)
    confused_with = ("corrupt_samples", "sample_jitter")
    excitation = "none: the raw counts show it; read at data-ready or at the sensor's own rate"
    harm = "the noise looks smaller than it is, and so do all uncertainties"

    def sentence(self, values: FloatArray) -> str:
        """Say the share."""
        return f"{values[0] * 100.0:.3g} % of the samples repeat the one before"


TERM = RepeatedSamples()
