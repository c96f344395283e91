"""The predicted total uncertainty of a calibration with a program: noise and hidden causes.

Every cause with a prior size is included as in `gyrorig solve` (`uncertainty`): it is marginalised
together with the fitted parameters. A solve also adds an expected error if the data suggest causes.
The prediction assumes a rig without these causes, in which noise alone suggests them.

What to use when: `predict_total` for a program; `TotalPrediction.decision` for its cost.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate import ObservabilityAnalysis
from gyrorig_solver.model import SignalState, Site, value_indices, why_not_testable
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.numerics import posterior_covariance
from gyrorig_solver.plan.effect_information import EffectInformation
from gyrorig_solver.plan.prediction import CALIBRATION_PARAMETERS, Prediction
from gyrorig_solver.plan.scan_templates import signal_states
from gyrorig_solver.plan.sensor_model import SensorModel
from gyrorig_solver.uncertainty import UncertaintySettings, UnitPosterior
from gyrorig_solver.uncertainty.fit_linearisation import sizes_of_signals
from gyrorig_solver.uncertainty.prior_effects import (
    UnidentifiedCause,
    prior_templates,
    scaled_tangents,
)


@dataclass(frozen=True, slots=True)
class PlanPrior:
    """Prior knowledge of the rig before a program is run."""

    settings: UncertaintySettings
    unit: UnitPosterior | None = None  # None: the table of prior sizes


@dataclass(frozen=True, slots=True, eq=False)
class Contribution:
    """Contribution of one cause to each parameter."""

    cause: str
    std: FloatArray  # (13,), of `CALIBRATION_PARAMETERS`, SI


@dataclass(frozen=True, slots=True, eq=False)
class TotalPrediction:
    """The predicted total uncertainty of a program."""

    type_b: FloatArray  # (13,), of `CALIBRATION_PARAMETERS`, SI
    posterior_std: FloatArray  # (13,), the part without the sizes that noise suggests
    contributions: tuple[Contribution, ...]  # of each cause, with all others marginalised
    # of the prediction, with the uncertainty from causes that a motion can show
    decision: ObservabilityAnalysis
    std: dict[str, float]  # total, by parameter, SI; nan if not observable

    def main_contribution(self, parameter: str) -> Contribution:
        """Return the largest contribution to a parameter."""
        index = CALIBRATION_PARAMETERS.index(parameter)
        return max(self.contributions, key=lambda contribution: contribution.std[index])


def predict_total(
    prediction: Prediction, sensor: SensorModel, site: Site, prior: PlanPrior
) -> TotalPrediction:
    """Predict the total uncertainty of a calibration with a program."""
    states = signal_states(prediction.session, sensor, site)
    causes = _prior_causes(states, prior.settings)
    if not causes:
        std = {name: prediction.std[name] for name in CALIBRATION_PARAMETERS}
        zeros = np.zeros(len(CALIBRATION_PARAMETERS))
        return TotalPrediction(zeros, zeros, (), prediction.decision, std)
    reduced = EffectInformation(prediction, sensor).reduce(
        [
            np.concatenate(
                [scaled_tangents(cause, row, state) for cause in causes for row in cause.templates]
            )
            for state in states
        ]
    )
    signals = [(cause.term, place) for cause in causes for place in cause.places]
    covariance = _posterior_covariance(reduced.information, causes, prior)
    by_noise = _noise_of_suggestions(covariance, reduced.information, causes, prior)
    added = covariance + by_noise
    jacobian = prediction.stated_jacobian[: len(CALIBRATION_PARAMETERS)]
    moved = jacobian @ reduced.absorbed
    type_b = _std_of(moved, added)
    # The uncertainty from causes that no program shows would hide the differences between programs.
    is_shown = np.array(
        [term.kind != "gauge" and place not in term.unseen_places for term, place in signals]
    )
    shown = reduced.absorbed[:, is_shown] @ added[np.ix_(is_shown, is_shown)]
    decision = replace(
        prediction.decision,
        covariance=prediction.decision.covariance + shown @ reduced.absorbed[:, is_shown].T,
    )
    names = np.array([term.cause for term, _ in signals])
    return TotalPrediction(
        type_b=type_b,
        posterior_std=_std_of(moved, covariance),
        contributions=tuple(
            Contribution(
                str(name),
                _std_of(moved[:, names == name], added[np.ix_(names == name, names == name)]),
            )
            for name in dict.fromkeys(names)
        ),
        decision=decision,
        std={
            name: float(np.hypot(prediction.std[name], part))
            for name, part in zip(CALIBRATION_PARAMETERS, type_b, strict=True)
        },
    )


def _prior_causes(
    states: Sequence[SignalState], settings: UncertaintySettings
) -> list[UnidentifiedCause]:
    """Return each cause with a prior size that can act in the motion."""
    causes = []
    for name, prior in settings.prior_sizes.items():
        term = catalogue()[name]
        is_possible = term.kind == "gauge" or (
            term.kind == "effect" and why_not_testable(term, states) is None
        )
        templates = (
            prior_templates(term, states, prior)
            if is_possible and prior.size > 0.0
            else np.zeros((0, 0))
        )
        if len(templates):
            sizes = tuple(range(len(value_indices(term, role="size"))))
            causes.append(UnidentifiedCause(term, prior, sizes, templates))
    return causes


def _posterior_covariance(
    information: FloatArray, causes: Sequence[UnidentifiedCause], prior: PlanPrior
) -> FloatArray:
    """Return the covariance of all sizes after the program, in units of the table's prior."""
    before = np.eye(len(information))
    if prior.unit is not None:
        positions, scales = (np.array(values) for values in sizes_of_signals(causes))
        unit = np.flatnonzero(positions >= 0)
        before[np.ix_(unit, unit)] = prior.unit.covariance[
            np.ix_(positions[unit], positions[unit])
        ] / np.outer(scales[unit], scales[unit])
    return posterior_covariance(information, before)


def _noise_of_suggestions(
    covariance: FloatArray,
    information: FloatArray,
    causes: Sequence[UnidentifiedCause],
    prior: PlanPrior,
) -> FloatArray:
    """Return the covariance of the sizes that noise suggests and that a solve does not correct."""
    suggested = np.asarray(covariance @ information @ covariance, dtype=np.float64)
    is_left: BoolArray = np.ones(len(suggested), dtype=np.bool_)
    if prior.unit is not None:
        is_left = np.array(sizes_of_signals(causes)[0]) < 0
    return np.asarray(suggested * np.outer(is_left, is_left), dtype=np.float64)


def _std_of(moved: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the standard deviation of parameters (p,) from sizes with a covariance, (p, k)."""
    variance = np.einsum("pk,kl,pl->p", moved, covariance, moved)
    return np.asarray(np.sqrt(np.clip(variance, 0.0, None)), dtype=np.float64)
