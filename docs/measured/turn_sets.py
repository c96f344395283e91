"""`imucal_ferraris` and `mpu6050_serial_log`: full turns by hand."""

import json
from importlib import import_module

import numpy as np
from docs.markdown import number, table
from docs.measured.sessions import LoadedRecording, MeasuredSets, gain_and_std, value_and_std
from docs.measured.tables import AXES, findings, gains_beside, reasons, refusals, untold

from gyrorig_solver.data import FloatArray

RATE_HZ = 102.4  # of the Ferraris session, by its repository's example


def imucal_result(measured: MeasuredSets) -> tuple[FloatArray, FloatArray]:
    """Gain and bias in deg/s that the installed imucal makes of the same session.

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
    # Its model: measured = K R true + K_ga acc + b.
    return np.asarray(calibration.K_g @ calibration.R_g, np.float64), np.asarray(
        calibration.b_g, np.float64
    )


def ferraris_found(measured: MeasuredSets) -> str:
    """The session's result."""
    return findings({"session": measured.calibration("FERRARIS")})


def ferraris_gains(measured: MeasuredSets) -> str:
    """The nine gains and those of imucal."""
    ours = gain_and_std(measured.calibration("FERRARIS"))
    return gains_beside(ours, imucal_result(measured)[0], ("gyrorig", "imucal"), 5)


def ferraris_bias(measured: MeasuredSets) -> str:
    """The bias and that of imucal."""
    bias, std = value_and_std(measured.calibration("FERRARIS"), "bias")
    theirs = imucal_result(measured)[1]
    rows = [
        [
            AXES[i],
            f"{number(np.degrees(bias[i]), 4)} ± {number(np.degrees(std[i]), 4)}",
            number(theirs[i], 4),
        ]
        for i in range(3)
    ]
    return table(["axis", "gyrorig, °/s", "imucal, °/s"], rows)


def ferraris_doubts(measured: MeasuredSets) -> str:
    """What this session does not tell."""
    return reasons({"session": measured.calibration("FERRARIS")})


def serial_found(measured: MeasuredSets) -> str:
    """Rest and turns solved together."""
    return findings({"rest and both turns": measured.calibration("MPU6050-SERIAL")})


def serial_sums(measured: MeasuredSets) -> str:
    """Each turn by a plain sum, with the bias of the rest's mean: no fit in it."""
    bias = float(measured.load("rest").samples.rate_rad_s[:, 0].mean())
    rows = []
    for name in ("forward", "up"):
        turn = measured.load(name)
        counted = _counted_rad(turn, bias)
        stated = turn.turns[0].angle_rad * float(turn.turns[0].axis[0])
        rows.append(
            [
                name,
                number(float(np.degrees(stated)), 0),
                number(float(np.degrees(counted)), 1),
                number(counted / stated, 4),
                number(turn.turns[0].std_rad / abs(stated), 4),
            ]
        )
    head = ["turn, x points", "stated, °", "summed, °", "summed / stated", "std of one turn"]
    return table(head, rows)


def _counted_rad(turn: LoadedRecording, bias_rad_s: float) -> float:
    samples = turn.samples
    return float(np.trapezoid(samples.rate_rad_s[:, 0] - bias_rad_s, samples.time_s))


def serial_refused(measured: MeasuredSets) -> str:
    """The turns without the rest."""
    return refusals(measured.runs["mpu6050-serial-log"])


def serial_untold(measured: MeasuredSets) -> str:
    """What two turns about one axis leave open."""
    calibration = measured.calibration("MPU6050-SERIAL")
    return f"The solver states no value for these parameters: {untold(calibration)}.\n\n" + reasons(
        {"all three": calibration}
    )
