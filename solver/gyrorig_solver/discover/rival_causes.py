"""The rejected alternatives of a cause, and the reasons as text."""

from collections.abc import Iterable

from gyrorig_solver.discover.cause_findings import RivalCause
from gyrorig_solver.discover.exact_fit import FittedCandidate


def describe_rivals(
    selected: FittedCandidate, alternatives: Iterable[tuple[FittedCandidate, float]]
) -> tuple[RivalCause, ...]:
    """Describe the rejected alternatives of a cause, each with the reason.

    Args:
        selected: the cause that was taken.
        alternatives: the other compared causes, each with its posterior probability.
    """
    return tuple(
        RivalCause(
            candidate.extension.term.cause,
            candidate.delta_log_likelihood - selected.delta_log_likelihood,
            posterior,
            _rejection_reason(
                candidate.delta_log_likelihood - selected.delta_log_likelihood,
                candidate.log_evidence - selected.log_evidence,
            ),
        )
        for candidate, posterior in alternatives
    )


def _rejection_reason(delta_log_likelihood: float, delta_log_evidence: float) -> str:
    if delta_log_evidence > 0.0:
        return "the alternative fits as well; the data cannot distinguish the two causes"
    if delta_log_likelihood > -1.0:
        return "the alternative fits as well, but with more parameters or an improbable size"
    return (
        f"the best fit of the alternative leaves {-delta_log_likelihood:.1f} nats of "
        "log-likelihood unexplained"
    )
