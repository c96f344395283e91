"""What a program shows of causes: against closed forms, a dense formulation, and the rig."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.fft import dct

from gyrorig_protocol.program import MotionProgram
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.discover.score_tests import detection_noncentrality
from gyrorig_solver.estimate import PARAMETER_NAMES
from gyrorig_solver.estimate.observability import prior_std
from gyrorig_solver.model import Site
from gyrorig_solver.pipeline import solve_recordings
from gyrorig_solver.plan import (
    DetectabilityReport,
    Prediction,
    RigModel,
    predict_detectability,
    predict_program,
)
from gyrorig_solver.plan.detectability import CauseDetectability
from gyrorig_solver.plan.scan_templates import signal_states
from gyrorig_solver.plan.sensor_model import SensorModel

ROOT = Path(__file__).parents[3]
Record = Callable[..., tuple[Path, dict[str, Any]]]
Array = np.ndarray[Any, np.dtype[np.float64]]
Shipped = Callable[[str], MotionProgram]


@pytest.fixture(scope="module")
def full(rig: RigModel, sensor: SensorModel, shipped: Shipped) -> DetectabilityReport:
    return predict_detectability(
        predict_program(shipped("full"), rig.unit, sensor), sensor, rig.site
    )


@pytest.fixture(scope="module")
def paper(rig: RigModel, sensor: SensorModel, shipped: Shipped) -> DetectabilityReport:
    return predict_detectability(
        predict_program(shipped("paper"), rig.unit, sensor), sensor, rig.site
    )


def detectability_of(
    outlook: DetectabilityReport, cause: str, place: str | None = None
) -> CauseDetectability:
    return next(f for f in outlook.causes if (f.term.cause, f.place) == (cause, place))


def test_noncentrality_of_one_degree_is_two_normal_quantiles() -> None:
    # z(1 - 0.01/2) + z(0.8) = 2.5758 + 0.8416; the far tail adds nothing. Of 100 tests:
    # z(1 - 0.00005) = 3.8906.
    assert detection_noncentrality(1, 1) == pytest.approx((2.67379 + 0.84162) ** 2, rel=1e-4)
    assert detection_noncentrality(1, 100) == pytest.approx((3.95984 + 0.84162) ** 2, rel=1e-4)
    assert (
        detection_noncentrality(3, 100)
        > detection_noncentrality(2, 100)
        > detection_noncentrality(1, 100)
    )


# Measured with another simulator and another finder, 300 s, four tilts and speeds. `full` lasts
# 132 s, has other starts and other noise folds:
# the same order is meant, a factor of four either way.
MEASURED = [
    ("axis_nonorthogonality", None, 2.2e-3),
    ("backlash", "pan", np.radians(0.0029)),
    ("backlash", "tilt", np.radians(0.0039)),
    ("clock_skew", None, 1.3e-6),
    ("clock_step", None, 0.4e-3),
    ("scale_asymmetry", "x", 6e-4),
    ("scale_cubic", "z", np.radians(0.1) / np.radians(100.0) ** 3),
    ("g_sensitivity", "yy", np.radians(0.017) / 9.81),
    ("worm_error", "pan", np.radians(0.00096)),
    ("eccentricity", "pan", np.radians(0.020)),
    ("step_resolution", "tilt", 1.3e-3),
    ("acceleration_error", "pan", 4.7e-4),
    ("bias_step", "x", np.radians(0.026)),
    ("board_slip", "z", 1e-3),
    ("lost_steps", "pan", np.radians(0.016)),
    ("thermal_scale", "z", 2.2e-4),
    ("s_curve", "pan", 15e-3),
]


@pytest.mark.parametrize(("cause", "place", "size"), MEASURED)
def test_detectable_sizes_are_those_measured_elsewhere(
    full: DetectabilityReport, cause: str, place: str | None, size: float
) -> None:
    detectability = detectability_of(full, cause, place)
    assert detectability.is_detectable
    assert size / 4.0 < detectability.worst_direction_size < 4.0 * size


def test_the_dangerous_causes_are_the_silent_ones(
    full: DetectabilityReport, paper: DetectabilityReport
) -> None:
    """Non-orthogonality: 0.993 absorbed, 46 deviations; backlash below 0.3 (same notes)."""
    silent = detectability_of(full, "axis_nonorthogonality")
    assert silent.absorbed > 0.98
    assert 15.0 < silent.parameter_bias_sigma < 140.0
    assert detectability_of(full, "backlash", "pan").parameter_bias_sigma < 0.5
    assert detectability_of(full, "worm_error", "pan").parameter_bias_sigma < 0.3
    # Pan at one tilt: undetectable at any size, and still harmful.
    unseen = detectability_of(paper, "axis_nonorthogonality")
    assert not unseen.is_detectable
    assert unseen.worst_direction_size > 0.1
    assert unseen.parameter_bias_sigma > 1.0
    for outlook in (full, paper):
        assert not detectability_of(
            outlook, "step_resolution", "pan"
        ).is_detectable  # a gauge, exactly
        assert {t.cause for t in outlook.fully_absorbed} >= {"tilt_zero", "wrong_full_scale"}


def test_confusable_causes_are_those_that_were_confused(
    full: DetectabilityReport, paper: DetectabilityReport
) -> None:
    pairs = {frozenset(pair.causes) for pair in full.confusable_pairs}
    # R2 of 0.84, 0.99, 0.81, 0.73 and 0.53 in the notes.
    for pair in (
        ("scale_asymmetry", "scale_quadratic"),
        ("step_resolution", "tilt_sag"),
        ("bias_ramp", "thermal_bias"),
        ("clock_skew", "clock_step"),
        ("scale_quadratic", "vibration_rectification"),
    ):
        assert frozenset(pair) in pairs, pair
    assert frozenset(("backlash", "base_compliance")) not in pairs
    assert all(0.5 < pair.share < 1.0 + 1e-9 for pair in full.confusable_pairs)
    assert len(paper.confusable_pairs) > len(full.confusable_pairs)


@pytest.mark.long
@pytest.mark.parametrize(
    ("cause", "place", "size"),
    [("axis_nonorthogonality", None, 2e-3), ("step_resolution", "tilt", 1e-3)],
)
def test_a_hidden_cause_moves_the_calibration_as_foreseen(
    cause: str,
    place: str | None,
    size: float,
    record: Record,
    rig: RigModel,
    sensor: SensorModel,
    shipped: Shipped,
) -> None:
    """The emulator shares no code with the model. Half the detectable size, same noise."""
    program = ROOT / "config" / "programs" / "quick.yaml"
    prediction = predict_program(shipped("quick"), rig.unit, sensor)
    foreseen = detectability_of(predict_detectability(prediction, sensor, rig.site), cause, place)
    assert size < foreseen.worst_direction_size
    fits = []
    for hide in ((), (f"{cause}@{place}:{size}" if place else f"{cause}:{size}",)):
        recording = read_recording(record(program, 6, *hide)[0])
        fits.append(solve_recordings([recording], recording.board_ids[0]))
    clean, moved = (fit.misalignment_rad if place is None else fit.scale for fit in fits)
    group, axis = foreseen.biased_parameter.split(".")
    assert group == ("misalignment" if place is None else "scale")
    expected_sigma = (
        foreseen.parameter_bias_sigma
        * size
        / foreseen.worst_direction_size
        * prediction.std[foreseen.biased_parameter]
    )
    k = "xyz".index(axis)
    assert abs(moved[k] - clean[k]) == pytest.approx(expected_sigma, rel=0.1)


def test_projection_agrees_with_dense_least_squares(
    rig: RigModel, sensor: SensorModel, shipped: Shipped
) -> None:
    """Every column and every unknown of the motion in one dense matrix, whitened by hand."""
    prediction = predict_program(shipped("quick"), rig.unit, sensor)
    outlook = predict_detectability(prediction, sensor)
    design, white, knowledge = dense(prediction, sensor)
    scene = signal_states(prediction.session, sensor, rig.site)[0]
    rows = [white(column) for column in design]
    base = np.concatenate([np.stack(rows, axis=1), knowledge])
    for cause, place in (
        ("axis_nonorthogonality", None),
        ("scale_asymmetry", "y"),
        ("base_compliance", "tilt"),
        ("clock_skew", None),
    ):
        detectability = detectability_of(outlook, cause, place)
        sizes = ["x", "y", "z"] if place == "y" else ["pan", "tilt"]
        column = detectability.term.tangent_signals(scene, detectability.template.values)[
            sizes.index(place) if place else 0
        ]
        effect = np.concatenate([white(column), np.zeros(len(knowledge))])
        solution, *_ = np.linalg.lstsq(base, effect, rcond=None)
        left = float(np.sum((effect - base @ solution) ** 2))
        tests = sum(
            max(1, len({f.place for f in outlook.causes if f.term is term}))
            for term in {f.term for f in outlook.causes}
        )
        wanted = detection_noncentrality(1, tests * detectability.template.template_count)
        # The motion's derivatives are taken on another grid here.
        assert detectability.worst_direction_size == pytest.approx(
            np.sqrt(wanted / left), rel=0.01
        ), cause


def dense(
    prediction: Prediction, sensor: SensorModel
) -> tuple[list[Array], Callable[[Array], Array], Array]:
    """Columns (n, 3) of gain, bias, offset and the motion; whitening; knowledge as rows."""
    series, reference = prediction.session.series, prediction.session.reference
    n = series.block_count
    scene = signal_states(prediction.session, sensor, Site())[0]
    fine_edges = series.block_edges_s(slice(0, n), scene.intervals_per_instant)
    rates = reference.evaluate(fine_edges)
    columns: list[Array] = []
    rate = scene.measure_sensor_rate(rates.rate_rad_s)
    for row in range(3):
        for column in range(3):
            entry = np.zeros((n, 3))
            entry[:, row] = rate[:, column]
            columns.append(entry)
    for axis in range(3):
        entry = np.zeros((n, 3))
        entry[:, axis] = 1.0
        columns.append(entry)
    early = reference.evaluate(fine_edges - 1e-5, derivatives=False).rate_rad_s
    late = reference.evaluate(fine_edges + 1e-5, derivatives=False).rate_rad_s
    slope = np.where(np.isfinite(late - early), (late - early) / 2e-5, 0.0)
    columns.append(-scene.measure_stage_rate(slope))
    local, shared = reference.information.size
    motion = np.zeros((local + shared, len(rates.rate_rad_s), 3))
    for part in rates.local:
        motion[part.unknown, part.first_interval : part.first_interval + len(part.values)] += (
            part.values
        )
    motion[local : local + len(rates.shared)] = rates.shared
    columns += [scene.measure_stage_rate(signal) for signal in motion]
    deviation = np.sqrt(sensor.noise.dct_variance(n))

    def white(column: Array) -> Array:
        return np.asarray(dct(column, axis=0, norm="ortho") / deviation).ravel()

    information = np.zeros((13 + local + shared,) * 2)
    information[:13, :13] = np.diag(prior_std(PARAMETER_NAMES) ** -2.0)
    information[13:, 13:] = reference.information.to_dense()
    values, vectors = np.linalg.eigh(information)
    return columns, white, np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
