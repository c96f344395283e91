"""A fit with its uncertainty budget and with the stored posterior of its unit.

What to use when: `assess_fit` before a calibration document is built; `add_to_unit` to store the
information of the fit on the unit.
"""

from dataclasses import dataclass, replace

from gyrorig_solver.calibration import UnitPriorRecord
from gyrorig_solver.estimate import GyroFit
from gyrorig_solver.estimate.corrected_fit import correct_fit
from gyrorig_solver.pipeline.board_data import BoardData
from gyrorig_solver.pipeline.board_results import CriticisedFit
from gyrorig_solver.pipeline.unit_prior import CONFLICT_REMARK, UnitKnowledge, contradicts
from gyrorig_solver.uncertainty import (
    UncertaintyBudget,
    UncertaintySettings,
    assess_space,
    assess_uncertainty,
)


@dataclass(frozen=True, slots=True, eq=False)
class AssessedFit:
    """A fit with its uncertainty budget; the unit's posterior has corrected its values."""

    fit: GyroFit
    budget: UncertaintyBudget | None = None  # None if the reference gives no rates
    unit_prior: UnitPriorRecord | None = None


def assess_fit(
    data: BoardData,
    criticised: CriticisedFit,
    settings: UncertaintySettings,
    knowledge: UnitKnowledge,
) -> AssessedFit:
    """Return the fit with its budget, corrected if the store has a posterior of the unit.

    Raises:
        InputError: the stored posterior of the unit is damaged.
    """
    if criticised.attitude_space is not None:
        return AssessedFit(criticised.fit, assess_space(criticised.attitude_space, settings))
    if criticised.solution is None:
        return AssessedFit(criticised.fit)
    prior = knowledge.prior_of(data.recordings, settings)
    if prior is None:
        return AssessedFit(criticised.fit, assess_uncertainty(criticised.solution, settings))
    budget = assess_uncertainty(criticised.solution, settings, unit_prior=prior.posterior)
    if budget.unit_information is None:
        return AssessedFit(criticised.fit, budget)
    if contradicts(prior.posterior, budget.unit_information):
        warnings = (*criticised.fit.warnings, CONFLICT_REMARK)
        fit = replace(criticised.fit, warnings=warnings)
        return AssessedFit(fit, assess_uncertainty(criticised.solution, settings))
    fit = correct_fit(criticised.fit, criticised.solution, budget.corrections)
    return AssessedFit(fit, budget, prior.record)


def add_to_unit(
    data: BoardData,
    criticised: CriticisedFit,
    assessed: AssessedFit,
    settings: UncertaintySettings,
    knowledge: UnitKnowledge,
) -> int | None:
    """Write the next version of the unit's posterior; return its number, None if none is needed.

    A fit that leaves a significant effect gives no reliable information about the unit. The same is
    true for a board that disagrees with the others about a cause of the unit.

    Raises:
        InputError: the newest version is damaged.
        MachineError: the store cannot be written.
    """
    information = None if assessed.budget is None else assessed.budget.unit_information
    if information is None or not criticised.is_adequate or criticised.disputed_causes:
        return None
    document = knowledge.add(data.recordings, data.board, information, settings)
    return None if document is None else document.version
