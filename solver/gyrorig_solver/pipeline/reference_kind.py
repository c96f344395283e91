"""The interface of a kind of reference to the pipeline.

What to use when: subclass `ReferenceKind` for a reference with a separate fit, for example to the
angle of each turn; subclass `motion_kind.MotionKind` for a reference that gives the rate at each
time.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.discover import FitCriticism
from gyrorig_solver.discover.fit_criticism import findings_without_rates
from gyrorig_solver.estimate import FittedTerm, GyroFit, ObservabilityReport
from gyrorig_solver.pipeline.board_data import BoardData
from gyrorig_solver.pipeline.board_results import (
    NO_CAUSE_REMARK,
    BoardExplanation,
    CriticisedFit,
    check_fitted_gain,
    check_raw_streams,
)
from gyrorig_solver.pipeline.gain_fit import GainFit
from gyrorig_solver.reference import ReferenceMotion

NO_RATES_REMARK = (
    "the program did not test the residual over time, because the reference gives angles but not "
    "the motion between them"
)


class ReferenceKind(ABC):
    """A kind of reference: whether recordings have it, and the fit to it."""

    title: str  # in a list of possible references, for example "known turns"
    preference: int  # if recordings have several kinds, the kind with the smallest number is used
    is_suggested = True  # in the message that recordings have no reference of any kind
    can_be_searched = False  # whether causes can be searched in the residual of its fit
    # Instructions for recording `x`, `y`, `z` (gain columns), `bias` and `time_offset`, for a
    # motion.
    remedies: Mapping[str, str] = MappingProxyType({})

    @abstractmethod
    def is_given(self, data: BoardData) -> bool:
        """Return whether a board's recordings have this reference."""

    @abstractmethod
    def fit(
        self, data: BoardData, extend: Sequence[str] = (), named_terms: Sequence[FittedTerm] = ()
    ) -> GyroFit:
        """Calibrate a board.

        Args:
            data: of the board.
            extend: causes of the catalogue to fit in addition to the base model.
            named_terms: causes that a search named, to be fitted too.

        Raises:
            InputError: the data are not sufficient.
            UsageError: the recordings cannot be solved together, or a cause cannot be fitted.
        """

    def fit_criticised(self, data: BoardData, requested: Sequence[str]) -> CriticisedFit:
        """Fit a board with requested causes, and test the residual; errors as `fit`."""
        return CriticisedFit(self.fit(data, requested), None, criticism=FitCriticism())

    def fit_explained(
        self, data: BoardData, requested: Sequence[str], explanation: BoardExplanation
    ) -> CriticisedFit:
        """Fit a board with the causes that a search named, and requested ones; errors as `fit`."""
        fit = explanation.fit
        if fit is None or requested:
            fit = self.fit(data, requested)
        return CriticisedFit(fit, None, explanation)

    def explain(self, data: BoardData, held_out: Recording | None) -> BoardExplanation:
        """Return the findings of a board; the named causes are tested on `held_out`.

        Raises:
            InputError: the data are not sufficient.
            UsageError: the recordings cannot be fitted together.
        """
        fit = self.fit(data)
        not_tested = () if held_out is None else (NO_CAUSE_REMARK.format(held_out.path.name),)
        return BoardExplanation(
            board=BoardId(data.board),
            recordings=data.recordings,
            findings=findings_without_rates(fit),
            raw_checks=(*check_raw_streams(data), check_fitted_gain(data, fit.gain)),
            report_series=None,
            remarks=(
                *data.missing,
                *fit.warnings,
                *fit.limited_reasons,
                NO_RATES_REMARK,
                *not_tested,
            ),
            fit_explanation=None,
            fit=fit,
        )

    def fit_gain(self, data: BoardData, index: int) -> GainFit | None:
        """Return the fit of one recording alone, None if it determines no gain.

        The gains of several recordings are compared before they are fitted together.

        Args:
            data: of the board.
            index: of the recording.

        Raises:
            InputError: the data of this recording are not sufficient.
        """
        del data, index
        return None

    def read_motion(self, recording: Recording, samples: GyroSamples) -> ReferenceMotion | None:
        """Return the motion on the samples' time axis, None if it is not known at each time."""
        del recording, samples
        return None

    def determine_observability(self, data: BoardData) -> ObservabilityReport:
        """Return which parameters the recordings determine; errors as `fit`."""
        return self.fit(data).observability


def refuse_causes(extend: Sequence[str]) -> None:
    """Raise an error for causes if the fit to the reference cannot contain them.

    Raises:
        UsageError: a cause is given.
    """
    if extend:
        raise UsageError(
            f"the option --extend names {', '.join(extend)}, but the reference of these recordings "
            "gives angles and not the rate at each time, so a fit cannot show a cause",
            "use `--extend none`, or record the board with a reference of its motion over time",
        )
