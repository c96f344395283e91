"""Information of a simulated motion on arbitrary effects, with the fitted parameters eliminated."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate import BASE_PARAMETERS, PARAMETER_NAMES, TYPICAL_MOUNT, marginalise
from gyrorig_solver.estimate.linear.normal_equations import NormalEquationsSum
from gyrorig_solver.estimate.linear.whitening import PartModel, WhitenedPart
from gyrorig_solver.estimate.observability import prior_std
from gyrorig_solver.estimate.reference_prediction import (
    PartDerivatives,
    predict_derivatives,
    predict_rate,
)
from gyrorig_solver.plan.prediction import Prediction
from gyrorig_solver.plan.sensor_model import SensorModel


@dataclass(frozen=True, slots=True, eq=False)
class ReducedEffects:
    """Information on the sizes of k effects, with the fitted parameters eliminated."""

    information: FloatArray  # (k, k)
    absorbed: FloatArray  # (13, k), change of gain, bias and time offset by each effect
    energy: FloatArray  # (k,), before the elimination


class EffectInformation:
    """Normal equations of a motion, for the base model and arbitrary effects."""

    def __init__(self, prediction: Prediction, sensor: SensorModel) -> None:
        """Prepare the motion of a prediction."""
        series, reference = prediction.session.series, prediction.session.reference
        self._reference, self._noise = reference, sensor.noise
        self._parts: list[tuple[FloatArray, BoolArray, PartDerivatives]] = []
        for blocks in series.part_slices():
            sampled = predict_rate(series, blocks, reference, 0.0)
            use = series.good[series.samples_of_blocks(blocks)] & sampled.known
            columns = predict_derivatives(series, blocks, reference, 0.0)
            self._parts.append(
                (series.block_means(sampled.rate, use), series.used_blocks(use), columns)
            )

    def reduce(self, effects: Sequence[FloatArray]) -> ReducedEffects:
        """Return the information on the sizes of effects.

        Args:
            effects: for each part of the series, the effects per unit of size, (k, blocks, 3).
        """
        local, _ = self._reference.information.size
        sums: list[NormalEquationsSum] = []
        for (rate, used, columns), signals in zip(self._parts, effects, strict=True):
            part = WhitenedPart.of(
                PartModel(rate, used, signals, columns), TYPICAL_MOUNT, self._noise
            )
            sums = sums or [NormalEquationsSum(self._noise, local, part.size)]
            sums[0].add(part, np.zeros_like(rate), is_whole_series=len(self._parts) == 1)
        normal = sums[0].total()
        size = BASE_PARAMETERS + len(effects[0])
        information = marginalise(normal, self._reference, size).information
        base = information[:BASE_PARAMETERS, :BASE_PARAMETERS]
        cross = information[:BASE_PARAMETERS, BASE_PARAMETERS:]
        # Directions that the motion does not determine have their prior. Without it, a cause in
        # such a direction would seem observable.
        absorbed = np.linalg.solve(base + np.diag(prior_std(PARAMETER_NAMES) ** -2.0), cross)
        return ReducedEffects(
            information=information[BASE_PARAMETERS:, BASE_PARAMETERS:] - cross.T @ absorbed,
            absorbed=np.asarray(absorbed, dtype=np.float64),
            energy=np.diag(normal.matrix.shared)[BASE_PARAMETERS:size].copy(),
        )
