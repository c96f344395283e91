"""Corrupt samples: words arrive with flipped bits or torn bytes.

y_k xor 2^b, or the bytes of two samples in one word (+-256 counts), gives isolated spikes whose
size is a power of two in the raw counts. The fourth difference (1, -4, 6, -4, 1) shows them in any
motion. A link without a check lets 46 % of the byte errors through as samples; a link with a CRC
lets none through.
"""

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.link_remedies import DAMAGED_WORDS
from gyrorig_solver.model.term import TermParameter
from gyrorig_solver.model.term_kinds import ZeroMeanTerm


class CorruptSamples(ZeroMeanTerm):
    """The share of corrupt samples."""

    cause = "corrupt_samples"
    title = "Data words are corrupted"
    equation = "a share of the words has flipped bits"
    part = "link"
    kind = "raw"
    scope = "recording"
    parameters = (
        TermParameter("share", "1", typical_size=1e-3, lower=0.0, upper=1.0, prior_std=0.1),
    )
    confused_with = ("repeated_samples",)
    remedy = "add a checksum to the frame, read all axes in one burst, and check the cable"
    file_remedy = DAMAGED_WORDS.file
    covariates = None
    picture = None
    excitation = (
        "no motion, because the raw counts show corrupted words; use frames with a checksum, and "
        "block data update (BDU)"
    )
    effect_if_ignored = "the fit rejects large errors as outliers; small errors add noise"

    def describe(self, values: FloatArray) -> str:
        return f"{values[0] * 100.0:.3g} % of the samples have corrupted words"


TERM = CorruptSamples()
