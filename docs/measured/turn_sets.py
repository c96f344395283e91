"""Tables of `imucal_ferraris` and `mpu6050_serial_log`, the sets with full turns by hand."""

import json
from importlib import import_module

import numpy as np
from docs.markdown import number, table
from docs.measured.sessions import (
    LoadedRecording,
    MeasuredSets,
    compute_gain_and_std,
    read_value_and_std,
)
from docs.measured.tables import AXES, compare_gains, list_unobservable, reasons, refusals, results

from gyrorig_solver.data import FloatArray

RATE_HZ = 102.4  # of the Ferraris session, from the example in its repository


def compute_imucal_result(measured: MeasuredSets) -> tuple[FloatArray, FloatArray]:
    """Return gain and bias in deg/s that the installed imucal computes from the same session.

    Raises:
        SystemExit: imucal is not installed.
    """
    try:
        imucal, pandas = import_module("imucal"), import_module("pandas")
    except ModuleNotFoundError as missing:
        raise SystemExit(f"{missing.name} is not installed: pip install -e '.[dev]'") from None
    folder = measured.data / "imucal_ferraris"
    readings = pandas.read_csv(folder / "example_ferraris_session.csv").set_index("n_samples")
    listed = json.loads((folder / "example_ferraris_session_list.json").read_text())
    regions = imucal.ferraris_regions_from_section_list(readings, pandas.DataFrame(listed).T)
    calibration = imucal.FerrarisCalibration().compute(
        regions, sampling_rate_hz=RATE_HZ, from_acc_unit="m/s^2", from_gyr_unit="deg/s"
    )
    # The model of imucal is: measured = K R true + K_ga acc + b.
    return np.asarray(calibration.K_g @ calibration.R_g, np.float64), np.asarray(
        calibration.b_g, np.float64
    )


def ferraris_results(measured: MeasuredSets) -> str:
    """Return the calibration of the session."""
    return results({"session": measured.read_calibration("FERRARIS")})


def ferraris_gains(measured: MeasuredSets) -> str:
    """Return our nine gains and those of imucal."""
    ours = compute_gain_and_std(measured.read_calibration("FERRARIS"))
    return compare_gains(ours, compute_imucal_result(measured)[0], ("gyrorig", "imucal"), 5)


def ferraris_bias(measured: MeasuredSets) -> str:
    """Return our bias and that of imucal."""
    bias, std = read_value_and_std(measured.read_calibration("FERRARIS"), "bias")
    theirs = compute_imucal_result(measured)[1]
    rows = [
        [
            AXES[i],
            f"{number(np.degrees(bias[i]), 4)} ± {number(np.degrees(std[i]), 4)}",
            number(theirs[i], 4),
        ]
        for i in range(3)
    ]
    return table(["axis", "gyrorig, °/s", "imucal, °/s"], rows)


def ferraris_reasons(measured: MeasuredSets) -> str:
    """Return the reasons and remarks of the solver for this session."""
    return reasons({"session": measured.read_calibration("FERRARIS")})


def serial_results(measured: MeasuredSets) -> str:
    """Return the calibration from the rest and both turns."""
    return results({"rest and both turns": measured.read_calibration("MPU6050-SERIAL")})


def serial_sums(measured: MeasuredSets) -> str:
    """Return the integral of each turn without a fit; the bias is the mean of the rest."""
    bias = float(measured.load_recording("rest").samples.rate_rad_s[:, 0].mean())
    rows = []
    for name in ("forward", "up"):
        turn = measured.load_recording(name)
        integrated = _integrate_rad(turn, bias)
        stated = turn.turns[0].angle_rad * float(turn.turns[0].axis[0])
        rows.append(
            [
                name,
                number(float(np.degrees(stated)), 0),
                number(float(np.degrees(integrated)), 1),
                number(integrated / stated, 4),
                number(turn.turns[0].std_rad / abs(stated), 4),
            ]
        )
    head = ["turn, x points", "stated, °", "summed, °", "summed / stated", "std of one turn"]
    return table(head, rows)


def _integrate_rad(turn: LoadedRecording, bias_rad_s: float) -> float:
    samples = turn.samples
    return float(np.trapezoid(samples.rate_rad_s[:, 0] - bias_rad_s, samples.time_s))


def serial_refusals(measured: MeasuredSets) -> str:
    """Return the rejected command, which has the turns without the rest."""
    return refusals(measured.runs["mpu6050-serial-log"])


def serial_unobservable(measured: MeasuredSets) -> str:
    """Return the parameters that two turns about one axis do not determine, with the reasons."""
    calibration = measured.read_calibration("MPU6050-SERIAL")
    return (
        f"The solver states no value for these parameters: {list_unobservable(calibration)}.\n\n"
        + reasons({"all three": calibration})
    )
