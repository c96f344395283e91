"""Words arrive damaged: flipped bits, torn bytes.

y_k xor 2^b, or the bytes of two samples in one word (+-256 counts): lone spikes whose size
is a power of two, in the raw counts; the fourth difference (1, -4, 6, -4, 1) brings them out
of any motion. A line without a check lets 46 % of byte faults through as samples; a CRC none.
"""

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.bases import UnseenTerm
from gyrorig_solver.model.terms.protocol import Kind, Part, Scope, TermParameter


class CorruptSamples(UnseenTerm):
    """The share of samples that are damaged."""

    cause = "corrupt_samples"
    part: Part = "link"
    kind: Kind = "raw"
    scope: Scope = "recording"
    parameters = (TermParameter("share", "1", typical=1e-3, lower=0.0, upper=1.0, prior_std=0.1),)
    confused_with = ("repeated_samples",)
    excitation = "none: the raw counts show it; use a frame format with a check, and BDU"
    harm = "set aside as spikes where they are large; small ones are noise"

    def sentence(self, values: FloatArray) -> str:
        """Say the share."""
        return f"{values[0] * 100.0:.3g} % of the samples have damaged words"


TERM = CorruptSamples()
