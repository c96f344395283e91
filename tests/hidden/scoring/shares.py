"""Share of trials with its exact confidence limits.

Source: Clopper and Pearson, Biometrika 26 (1934) 404.
"""

from dataclasses import dataclass

from scipy.stats import beta

TAIL = 0.025


@dataclass(frozen=True, slots=True)
class Share:
    """Hits out of trials."""

    hits: int
    trials: int

    @property
    def value(self) -> float:
        """The share, NaN if there were no trials."""
        return self.hits / self.trials if self.trials else float("nan")

    @property
    def low(self) -> float:
        """Lower end of the exact 95 % interval."""
        if not self.hits:
            return 0.0
        return float(beta.ppf(TAIL, self.hits, self.trials - self.hits + 1))

    @property
    def high(self) -> float:
        """Upper end of the exact 95 % interval."""
        if self.hits >= self.trials:
            return 1.0
        return float(beta.ppf(1.0 - TAIL, self.hits + 1, self.trials - self.hits))

    @property
    def upper(self) -> float:
        """Exact one-sided 95 % upper limit."""
        if self.hits >= self.trials:
            return 1.0
        return float(beta.ppf(0.95, self.hits + 1, self.trials - self.hits))

    def __str__(self) -> str:
        """Text for the page."""
        if not self.trials:
            return "none tried"
        limits = f"{100 * self.low:.1f} to {100 * self.high:.1f} %"
        return f"{self.hits} of {self.trials} = {100 * self.value:.1f} % ({limits})"
