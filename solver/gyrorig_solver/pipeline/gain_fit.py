"""The interface of a fit to one recording alone, whose gain is compared with that of others."""

from abc import ABC, abstractmethod

from gyrorig_solver.uncertainty import GainEstimate


class GainFit(ABC):
    """A fit to one recording alone; see `ReferenceKind.fit_gain`."""

    @property
    @abstractmethod
    def converged(self) -> bool:
        """Whether the values are a result."""

    @abstractmethod
    def estimate(self, name: str, with_causes: bool) -> GainEstimate:
        """Return the gain of the fit.

        Args:
            name: of the recording.
            with_causes: whether the uncertainty includes causes that the fit has not identified.
        """

    def searched(self) -> "GainFit":
        """Return the fit with the causes that a search finds; itself if causes have no search."""
        return self
