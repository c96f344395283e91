"""Compares several named causes of one covariate with a single smooth function of it.

Two named causes can imitate one effect that is not in the catalogue. For example, a ramp and a step
of the bias imitate a bias that lags behind the temperature. Each of them passes its own
specification test, because the other cause follows the rest. Therefore the check compares two
models by their evidence: all causes of the covariate together, and one smooth function of the
covariate in their place.

What to use when: `SharedCovariateCheck` after a search.
"""

from collections.abc import Sequence

from gyrorig_solver.discover.checks.model_check import JudgedModel, Verdict
from gyrorig_solver.discover.checks.specification_tests import DECISIVE_NATS, best_function_nats
from gyrorig_solver.discover.exact_fit import fit_candidate
from gyrorig_solver.discover.fit_space import Space

MIN_CAUSES = 2  # one cause of a covariate has its own specification test


class SharedCovariateCheck:
    """Rejects the causes of a covariate if one smooth function of it is about as probable."""

    removes_names = True

    def judge(self, model: JudgedModel[Space]) -> Verdict:
        """Return the causes whose evidence does not clearly exceed that of a smooth function."""
        removed: set[int] = set()
        for covariate, indices in _causes_by_covariate(model).items():
            if len(indices) >= MIN_CAUSES and not _lead_function(model, covariate, indices):
                removed.update(indices)
        return Verdict(tuple(k in removed for k, _ in model.fitted_causes))


def _causes_by_covariate(model: JudgedModel[Space]) -> dict[str, list[int]]:
    """Return the indices of the causes that depend on one covariate only, by that covariate.

    Spectral lines are excluded, because a smooth function cannot follow them.
    """
    groups: dict[str, list[int]] = {}
    for k, _ in model.fitted_causes:
        term = model.space.fitted_terms[k].term
        covariates = term.covariates or ()
        if len(covariates) == 1 and term.template_search != "spectral_lines":
            groups.setdefault(covariates[0], []).append(k)
    return groups


def _lead_function(model: JudgedModel[Space], covariate: str, indices: Sequence[int]) -> bool:
    """Return whether some causes are decisively more probable than a function in their place."""
    function_nats = best_function_nats(model.space.projector_without(*indices), covariate)
    return _joint_evidence_nats(model, indices) > function_nats + DECISIVE_NATS


def _joint_evidence_nats(model: JudgedModel[Space], indices: Sequence[int]) -> float:
    """Return the log evidence of some causes together, relative to none of them.

    It is the sum over the causes in the order of their statistics. Each cause is fitted in addition
    to those before it. The ranking already has the evidence of the last cause in addition to all
    others.
    """
    ranked_by_index = dict(model.fitted_causes)
    ordered = sorted(indices, key=lambda k: -ranked_by_index[k].statistic)
    nats = ranked_by_index[ordered[-1]].candidate.log_evidence
    for position, k in enumerate(ordered[:-1]):
        fitted_term, ranked = model.space.fitted_terms[k], ranked_by_index[k]
        projector = model.space.projector_without(*ordered[position:])
        fitted = fit_candidate(
            projector, fitted_term.term, ranked.candidate.place, [fitted_term.values]
        )
        nats += 0.0 if fitted is None else fitted.log_evidence
    return nats
