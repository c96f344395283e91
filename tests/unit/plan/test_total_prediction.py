"""The predicted total uncertainty: what the search does with it, and what a solve then states."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from gyrorig_protocol.program import MotionProgram
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.discover.calibration_changes import CalibrationValues
from gyrorig_solver.pipeline.board_data import load_board
from gyrorig_solver.pipeline.prepare_board import fit_base
from gyrorig_solver.plan import RigModel, find_program, predict_program, predict_total
from gyrorig_solver.plan.prediction import CALIBRATION_PARAMETERS
from gyrorig_solver.plan.sensor_model import SensorModel
from gyrorig_solver.plan.total_prediction import PlanPrior
from gyrorig_solver.uncertainty import (
    UncertaintySettings,
    UnitPosterior,
    assess_uncertainty,
    default_settings,
)
from gyrorig_solver.uncertainty.uncertainty_settings import PriorSize
from gyrorig_solver.uncertainty.unit_values import UnitInformation, unit_value_names

ROOT = Path(__file__).parents[3]
Record = Callable[..., tuple[Path, dict[str, Any]]]
Shipped = Callable[[str], MotionProgram]
SQUARENESS_RAD = 1.3e-3


def only(**sizes: float) -> UncertaintySettings:
    """Return settings in which only these causes have a prior size."""
    priors = {cause: PriorSize(size, 1.0) for cause, size in sizes.items()}
    return replace(default_settings(), prior_sizes=MappingProxyType(priors))


@pytest.mark.long
def test_the_search_adds_tilts_when_squareness_dominates(
    rig: RigModel, sensor: SensorModel
) -> None:
    squareness = PlanPrior(only(axis_nonorthogonality=SQUARENESS_RAD))
    by_noise = find_program(rig.unit, sensor, 40.0, prior=PlanPrior(only()))
    by_total = find_program(rig.unit, sensor, 40.0, prior=squareness)
    assert by_noise.design.poses == 2
    assert by_total.design.poses >= 3
    blind = predict_total(by_noise.prediction, sensor, rig.site, squareness)
    for name in ("misalignment.y", "nonorthogonality.zx"):
        assert by_total.total.std[name] < 0.7 * blind.std[name]
    assert blind.std["misalignment.y"] > SQUARENESS_RAD
    assert by_total.prediction.gain_std.max() >= by_noise.prediction.gain_std.max()


def test_without_prior_sizes_the_total_is_the_noise(
    rig: RigModel, sensor: SensorModel, shipped: Shipped
) -> None:
    prediction = predict_program(shipped("quick"), rig.unit, sensor)
    total = predict_total(prediction, sensor, rig.site, PlanPrior(only()))
    assert total.std == {name: prediction.std[name] for name in CALIBRATION_PARAMETERS}


def test_a_known_unit_adds_less(rig: RigModel, sensor: SensorModel, shipped: Shipped) -> None:
    """Squareness that is known to 0.1 mrad is not the largest contribution any more."""
    settings, size = default_settings(), len(unit_value_names())
    matrix = np.zeros((size, size))
    squareness = unit_value_names().index("axis_nonorthogonality.angle")
    matrix[squareness, squareness] = 1e-4**-2.0
    unit = UnitPosterior.from_table(settings).updated(UnitInformation(matrix, np.zeros(size)))
    prediction = predict_program(shipped("quick"), rig.unit, sensor)
    unknown = predict_total(prediction, sensor, rig.site, PlanPrior(settings))
    known = predict_total(prediction, sensor, rig.site, PlanPrior(settings, unit))
    assert unknown.main_contribution("misalignment.y").cause == "axis_nonorthogonality"
    assert known.main_contribution("misalignment.y").cause != "axis_nonorthogonality"
    assert known.std["misalignment.y"] < unknown.std["misalignment.y"]


@pytest.mark.long
def test_a_solve_states_the_predicted_total(
    rig: RigModel, sensor: SensorModel, shipped: Shipped, record: Record
) -> None:
    """Without the expected error, which depends on the noise of one recording.

    Thermal causes are left out: the prediction can only assume a temperature.
    """
    settings = default_settings()
    thermal = ("warm_up", "thermal_bias", "thermal_scale")
    sizes = {name: size for name, size in settings.prior_sizes.items() if name not in thermal}
    settings = replace(settings, prior_sizes=MappingProxyType(sizes))
    prediction = predict_program(shipped("survey-40"), rig.unit, sensor)
    total = predict_total(prediction, sensor, rig.site, PlanPrior(settings))
    noise_std = [prediction.std[name] for name in CALIBRATION_PARAMETERS]
    path, _ = record(ROOT / "config" / "programs" / "survey-40.yaml", 3)
    recording = read_recording(path)
    fit = fit_base(load_board([recording], str(recording.board_ids[0])))
    causes_std = np.sqrt(np.diag(assess_uncertainty(fit, settings).covariance))
    stated = np.hypot(CalibrationValues.of(fit).std, causes_std)
    assert np.hypot(noise_std, total.posterior_std) == pytest.approx(stated, rel=0.15)
