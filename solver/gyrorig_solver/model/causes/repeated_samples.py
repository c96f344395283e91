"""Repeated samples: the sensor is read faster than it produces new samples.

y_k = y_{k-1}, all three words identical. A BMI088 published 1250 samples per second, of which 1000
were new. The raw counts show it: with noise above one count a true repetition of three words is
rare. In the mean it is a lag of share/2 periods, which is part of the time offset.
"""

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.link_remedies import REPEATS
from gyrorig_solver.model.term import TermParameter
from gyrorig_solver.model.term_kinds import ZeroMeanTerm


class RepeatedSamples(ZeroMeanTerm):
    """The share of samples that repeat the previous one."""

    cause = "repeated_samples"
    title = "Samples are repeated"
    equation = "y_k = y_(k-1) for a share of the samples"
    part = "clock"
    kind = "raw"
    scope = "recording"
    parameters = (
        TermParameter("share", "1", typical_size=0.1, lower=0.0, upper=1.0, prior_std=1.0),
    )
    confused_with = ("corrupt_samples", "sample_jitter")
    remedy = "read the sensor at its data-ready signal or at its output rate"
    file_remedy = REPEATS.file
    covariates = None
    picture = None
    excitation = (
        "no motion, because the raw counts show repeated samples; read the sensor at its output "
        "rate"
    )
    effect_if_ignored = "the noise and all uncertainties appear smaller than they are"

    def describe(self, values: FloatArray) -> str:
        return f"{values[0] * 100.0:.3g} % of the samples repeat the previous one"


TERM = RepeatedSamples()
