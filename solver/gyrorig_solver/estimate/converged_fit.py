"""The end of a fit of one board: parameters, their information, and each recording's state.

What to use when: `ConvergedFit` is the result of `likelihood_fit` and `multi_board_fit`;
`motion_fit` turns it into physical parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.information import PARAMETER_NAMES
from gyrorig_solver.estimate.noise.noise_model import NoiseModel
from gyrorig_solver.estimate.noise.residual_spectrum import Spectrum
from gyrorig_solver.estimate.observability import ObservabilityAnalysis
from gyrorig_solver.estimate.parameter_layout import GAIN_PARAMETERS
from gyrorig_solver.estimate.session_fit import SessionFit
from gyrorig_solver.estimate.trust_region import Convergence


@dataclass(frozen=True, slots=True, eq=False)
class ConvergedFit:
    """The end of a fit: parameters, their information, and the state of each recording.

    Its values are a result only if `converged` is true.
    """

    names: tuple[str, ...]  # G row by row, b, time offset, then the causes' values
    prior_std: FloatArray  # (p,), prior standard deviation of each
    estimate: FloatArray  # (p,); bias: last recording. Time offset (whole lag): last
    # recording in which it is observable
    # all other unknowns marginalised, including the common shift
    observability: ObservabilityAnalysis
    sessions: tuple[SessionFit, ...]
    fitted_terms: tuple[FittedTerm, ...]
    session_observability: tuple[
        ObservabilityAnalysis, ...
    ]  # the same with the b and tau of each recording
    noises: tuple[NoiseModel, ...]  # of each recording
    spectra: tuple[Spectrum, ...]
    noise_sources: tuple[str, ...]  # the part of each recording used for the noise
    outliers: int
    convergence: Convergence

    @property
    def converged(self) -> bool:
        """Whether further iterations would not change the result."""
        return self.convergence.converged

    @property
    def offset_recording(self) -> int:
        """The recording of the time offset: the last one that shows it. A rest does not."""
        return last_with_offset(self.session_observability)

    @property
    def gain(self) -> FloatArray:
        """G, shape (3, 3)."""
        return self.estimate[:GAIN_PARAMETERS].reshape(3, 3)

    def release_caches(self) -> None:
        """Free the data that can be computed again."""
        for session in self.sessions:
            session.release_caches()

    def residuals(self) -> list[FloatArray]:
        """Return measured minus modelled rates of every series of every recording."""
        return [residual for session in self.sessions for residual in session.residuals(self.gain)]

    def whitened_residuals(self) -> list[FloatArray]:
        """Return the residuals in units of their standard deviation, white."""
        return [
            white
            for session, noise in zip(self.sessions, self.noises, strict=True)
            for white in session.whitened_residuals(self.gain, noise)
        ]

    def used_blocks(self) -> list[BoolArray]:
        """Return which blocks of every series are used."""
        return [used for session in self.sessions for used in session.used]


def last_with_offset(analyses: Sequence[ObservabilityAnalysis]) -> int:
    """Return the last recording that shows the time offset; the last one if none does."""
    position = PARAMETER_NAMES.index("time_offset")
    observable = [k for k, analysis in enumerate(analyses) if analysis.is_observable(position)]
    return observable[-1] if observable else len(analyses) - 1
