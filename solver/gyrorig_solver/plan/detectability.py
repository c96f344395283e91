"""Detectability of each cause of the catalogue under a program.

A cause is projected orthogonally to the fitted parameters (gain, bias, time offset, the unknowns of
the motion) and whitened by the noise. The remainder determines its minimum detectable size, its
similarity to other causes, and the bias of the calibration while the cause is not detected
(geodesy: external reliability, Baarda).

What to use when: `predict_detectability` for a program; `detectability_table` prints its result.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.score_tests import detection_noncentrality
from gyrorig_solver.model import (
    SignalState,
    Site,
    Term,
    components_of,
    value_indices,
    value_parameters,
    why_not_testable,
)
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.plan.effect_information import EffectInformation, ReducedEffects
from gyrorig_solver.plan.prediction import STATED_PARAMETERS, Prediction
from gyrorig_solver.plan.scan_templates import (
    ScanTemplate,
    scan_templates,
    signal_states,
    template_batches,
)
from gyrorig_solver.plan.sensor_model import SensorModel

# of a cause's energy; a pair is confusable if one cause absorbs a larger share of the other
CONFUSABLE_SHARE = 0.5
MAX_SHARED_ENERGY, UNDETECTABLE_SIZE = 0.99, 1000.0
SIZE_EXPONENTS = (0.5, 4.0)  # bounds of the exponent with which an effect grows with its size
MAX_BATCH_VALUES = 2_000_000  # of the causes' derivatives on one sensor axis, in memory at a time


@dataclass(frozen=True, slots=True, eq=False)
class CauseDetectability:
    """The detectability of one cause at one of its places under a program."""

    term: Term
    place: str | None  # x, y, z, pan, tilt; None if it has no place
    best_direction_size: float  # detectable size, SI, in the most visible direction
    worst_direction_size: float  # in the least visible direction
    typical: float  # size of an ordinary rig, SI
    unit: str
    absorbed: float  # share of the effect's energy that the fitted parameters absorb
    biased_parameter: str  # parameter with the largest bias if the cause is not detected
    parameter_bias_sigma: float  # this bias at the detectable size, in standard deviations
    template: ScanTemplate
    max_shared_energy: float = 0.0  # share of its energy that the most similar other cause absorbs

    @property
    def identifiable_size(self) -> float:
        """Size from which the cause can be separated from the most similar other cause, SI.

        The share of energy that the other cause absorbs does not count. For nearly equal causes,
        which no motion separates, this share is limited to `MAX_SHARED_ENERGY`.
        """
        return self.worst_direction_size / float(
            np.sqrt(1.0 - min(self.max_shared_energy, MAX_SHARED_ENERGY))
        )

    @property
    def is_detectable(self) -> bool:
        """Whether a possible size is detectable."""
        parameter = value_parameters(self.term)[value_indices(self.term, self.place, "size")[0]]
        return self.worst_direction_size <= max(abs(parameter.lower), abs(parameter.upper))


@dataclass(frozen=True, slots=True)
class ConfusablePair:
    """Two causes that a program can hardly distinguish."""

    causes: tuple[str, str]
    places: tuple[str | None, str | None]
    share: float  # of the energy of one cause that the other absorbs


@dataclass(frozen=True, slots=True, eq=False)
class DetectabilityReport:
    """The detectability of the whole catalogue under a program."""

    causes: tuple[CauseDetectability, ...]
    confusable_pairs: tuple[ConfusablePair, ...]  # the most similar first
    fully_absorbed: tuple[
        Term, ...
    ]  # not visible in any program: gain, bias and time offset absorb them completely
    other_methods: tuple[Term, ...]  # detected in the noise or the raw stream, not in a motion
    not_applicable: tuple[tuple[Term, str], ...]  # cannot be tested here, with the reason

    @property
    def mean_identifiable_size(self) -> float:
        """Geometric mean over the causes of the identifiable size in typical sizes.

        With a geometric mean, a cause that is known ten times better counts as much as another one
        that is known ten times worse. An undetectable cause counts as `UNDETECTABLE_SIZE`.
        """
        logs: dict[str, list[float]] = {}
        for cause in self.causes:
            size = min(cause.identifiable_size / cause.typical, UNDETECTABLE_SIZE)
            logs.setdefault(cause.term.cause, []).append(float(np.log(size)))
        return float(np.exp(np.mean([np.mean(places) for places in logs.values()])))


def predict_detectability(
    prediction: Prediction, sensor: SensorModel, site: Site | None = None
) -> DetectabilityReport:
    """Predict the detectability of every cause under a program."""
    states = signal_states(prediction.session, sensor, site or Site())
    causes = tuple(catalogue().values())
    testable = [
        term
        for term in causes
        if term.kind in ("effect", "known") and why_not_testable(term, states) is None
    ]
    missing = [
        (term, why_not_testable(term, states))
        for term in causes
        if term.kind in ("effect", "known")
    ]
    test_count = sum(max(1, len(components_of(term))) for term in testable)
    cause_information = _TemplateInformation(prediction, sensor, states)
    by_place: dict[tuple[str, str | None], list[_TemplateDetectability]] = {}
    for batch in template_batches(
        [template for term in testable for template in scan_templates(term, states[0])],
        cause_information.max_batch_sizes,
    ):
        reduced = cause_information.reduce(batch)
        for template in batch:
            for place in components_of(template.term) or (None,):
                detectability = reduced.detectability(
                    template, place, template_noncentrality(template, place, test_count)
                )
                by_place.setdefault((template.term.cause, place), []).append(detectability)
    estimates = [_summarize_place(templates) for templates in by_place.values()]
    compared, pairs = _compare_causes(estimates, cause_information)
    return DetectabilityReport(
        causes=tuple(sorted(compared, key=lambda f: -f.parameter_bias_sigma)),
        confusable_pairs=pairs,
        fully_absorbed=tuple(term for term in causes if term.kind == "gauge"),
        other_methods=tuple(term for term in causes if term.kind in ("stochastic", "raw")),
        not_applicable=tuple((term, reason) for term, reason in missing if reason is not None),
    )


def template_noncentrality(template: ScanTemplate, place: str | None, test_count: int) -> float:
    """Return the non-centrality that detects one template of a catalogue scan."""
    return detection_noncentrality(
        len(value_indices(template.term, place, "size")), test_count * template.template_count
    )


@dataclass(frozen=True, slots=True, eq=False)
class _TemplateDetectability:
    """The detectability of one template at one place, in typical sizes."""

    template: ScanTemplate
    place: str | None
    sizes: FloatArray  # (d,), detectable in each principal direction, best first
    absorbed: float
    bias_sigma: FloatArray  # (p,), of each parameter


class _TemplateInformation:
    """Information of a motion on templates of causes."""

    def __init__(
        self, prediction: Prediction, sensor: SensorModel, scenes: Sequence[SignalState]
    ) -> None:
        self._effects = EffectInformation(prediction, sensor)
        self._scenes, self._prediction = scenes, prediction
        self.max_batch_sizes = max(
            16, MAX_BATCH_VALUES // max(scene.block_count for scene in scenes)
        )

    def reduce(self, templates: Sequence[ScanTemplate]) -> "_ReducedInformation":
        """Return the information on the causes' sizes with the base model eliminated."""
        reduced = self._effects.reduce(
            [
                np.concatenate(
                    [
                        template.term.tangent_signals(scene, template.values)
                        * template.typical_sizes[:, None, None]
                        for template in templates
                    ]
                )
                for scene in self._scenes
            ]
        )
        return _ReducedInformation(templates, reduced, self._prediction)


class _ReducedInformation:
    """The information on templates' sizes with the base model eliminated."""

    def __init__(
        self,
        templates: Sequence[ScanTemplate],
        reduced: ReducedEffects,
        prediction: Prediction,
    ) -> None:
        self._raw, self.information = reduced.energy, reduced.information
        first = np.cumsum([0, *(template.typical_sizes.size for template in templates)])
        self._first = {
            id(template): int(position)
            for template, position in zip(templates, first[:-1], strict=True)
        }
        self._std = prediction.stated_std
        self._moved = prediction.stated_jacobian @ reduced.absorbed

    def index(self, template: ScanTemplate, place: str | None) -> list[int]:
        """Return the rows and columns of `information` of a template at a place."""
        sizes = value_indices(template.term, role="size")
        return [
            self._first[id(template)] + sizes.index(k)
            for k in value_indices(template.term, place, role="size")
        ]

    def detectability(
        self, template: ScanTemplate, place: str | None, noncentrality: float
    ) -> _TemplateDetectability:
        """Return the detectability of a template at a place for a non-centrality."""
        positions = self.index(template, place)
        energy = float(np.sum(self._raw[positions]))
        if energy <= 0.0:
            undetectable = np.full(len(positions), np.inf)
            return _TemplateDetectability(
                template, place, undetectable, 1.0, np.zeros(len(STATED_PARAMETERS))
            )
        values, vectors = np.linalg.eigh(self.information[np.ix_(positions, positions)])
        values = np.maximum(values[::-1], 1e-15 * energy)
        sizes = np.sqrt(noncentrality / values)
        # A size beyond the largest possible one cannot occur. An undetectable cause biases the
        # calibration by its typical size instead.
        possible = np.where(sizes <= _largest_size(template, place), sizes, 1.0)
        shift = self._moved[:, positions] @ vectors[:, ::-1] * possible
        bias_sigma = np.sqrt(np.sum(shift**2, axis=1)) / self._std
        return _TemplateDetectability(
            template, place, sizes, 1.0 - float(np.sum(values)) / energy, bias_sigma
        )


def _largest_size(template: ScanTemplate, place: str | None) -> float:
    """Return the largest possible size, in typical sizes."""
    parameter = value_parameters(template.term)[value_indices(template.term, place, "size")[0]]
    return max(abs(parameter.lower), abs(parameter.upper)) / parameter.typical_size


def _summarize_place(templates: Sequence[_TemplateDetectability]) -> CauseDetectability:
    is_scanned = templates[0].template.size > 0.0
    chosen = _just_detectable_template(templates) if is_scanned else _median_template(templates)
    place, template = chosen.place, chosen.template
    parameter = value_parameters(template.term)[value_indices(template.term, place, "size")[0]]
    worst = int(np.argmax(chosen.bias_sigma))
    return CauseDetectability(
        term=template.term,
        place=place,
        best_direction_size=float(chosen.sizes[0]) * parameter.typical_size,
        worst_direction_size=float(chosen.sizes[-1]) * parameter.typical_size,
        typical=parameter.typical_size,
        unit=parameter.unit,
        absorbed=chosen.absorbed,
        biased_parameter=STATED_PARAMETERS[worst],
        parameter_bias_sigma=float(chosen.bias_sigma[worst]),
        template=template,
    )


def _median_template(templates: Sequence[_TemplateDetectability]) -> _TemplateDetectability:
    """Return the template with the median detectable size of the detectable templates."""
    detectable = [template for template in templates if np.isfinite(template.sizes[-1])] or list(
        templates
    )
    return sorted(detectable, key=lambda template: float(template.sizes[-1]))[
        (len(detectable) - 1) // 2
    ]


def _just_detectable_template(
    templates: Sequence[_TemplateDetectability],
) -> _TemplateDetectability:
    """Return the template whose size is just detected.

    The effect is interpolated and extrapolated as a power of its size.
    """
    size = np.array([template.template.size for template in templates])
    detectable = np.array([template.sizes[-1] for template in templates])
    ratio = size / detectable  # 1: just detected
    nonzero = np.flatnonzero(ratio > 0.0)
    if not nonzero.size:
        return templates[-1]
    above = np.flatnonzero(ratio >= 1.0)
    chosen = int(above[0]) if above.size else int(nonzero[-1])
    neighbours = [k for k in (chosen - 1, chosen + 1) if k in nonzero and size[k] != size[chosen]]
    power = 1.0
    if neighbours:
        other = neighbours[0]
        power = float(np.log(ratio[chosen] / ratio[other]) / np.log(size[chosen] / size[other]))
    size_at_limit = size[chosen] * float(ratio[chosen]) ** (-1.0 / np.clip(power, *SIZE_EXPONENTS))
    if chosen > 0 and chosen - 1 not in nonzero:
        # the effect is zero at that smaller size
        size_at_limit = max(size_at_limit, size[chosen - 1])
    # The bias is that of a just detected effect, so the scaling of the sizes does not change it.
    template, factor = templates[chosen], size_at_limit / detectable[chosen]
    return _TemplateDetectability(
        template.template,
        template.place,
        template.sizes * factor,
        template.absorbed,
        template.bias_sigma,
    )


def _compare_causes(
    causes: Sequence[CauseDetectability], cause_information: _TemplateInformation
) -> tuple[tuple[CauseDetectability, ...], tuple[ConfusablePair, ...]]:
    """Return the causes with their largest overlap, and the confusable pairs."""
    detectable = [cause for cause in causes if cause.is_detectable]
    templates = list({id(cause.template): cause.template for cause in detectable}.values())
    if not templates:
        return tuple(causes), ()
    joint = cause_information.reduce(templates)
    positions = [joint.index(cause.template, cause.place) for cause in detectable]
    best: dict[tuple[str, str], ConfusablePair] = {}
    max_shared = {id(cause): 0.0 for cause in causes}
    for j, cause in enumerate(detectable):
        for k, other in enumerate(detectable[:j]):
            if cause.term.cause == other.term.cause:
                continue
            share = _shared_energy(joint.information, positions[j], positions[k])
            max_shared[id(cause)] = max(max_shared[id(cause)], share)
            max_shared[id(other)] = max(max_shared[id(other)], share)
            names = (other.term.cause, cause.term.cause)
            if share > max(CONFUSABLE_SHARE, best[names].share if names in best else 0.0):
                best[names] = ConfusablePair(names, (other.place, cause.place), share)
    pairs = tuple(sorted(best.values(), key=lambda pair: -pair.share))
    return tuple(replace(cause, max_shared_energy=max_shared[id(cause)]) for cause in causes), pairs


def _shared_energy(information: FloatArray, a: list[int], b: list[int]) -> float:
    """Return the share of energy that one of two causes absorbs of the other, at most 1."""
    cross = information[np.ix_(a, b)]
    overlap = np.linalg.solve(information[np.ix_(a, a)], cross) @ np.linalg.solve(
        information[np.ix_(b, b)], cross.T
    )
    return float(np.trace(overlap)) / min(len(a), len(b))
