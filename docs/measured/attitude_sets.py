"""`broad` and `car_imu_can`: gyros with a reference attitude."""

from itertools import combinations

import numpy as np
from docs.markdown import number, table
from docs.measured.sessions import LoadedRecording, MeasuredSets, gain_and_std, value_and_std
from docs.measured.tables import MILLI, findings, reasons, refusals

from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.data import FloatArray

# trial: (board, version) as the page's commands make them
VERSIONS = {
    "02": ("BROAD-1", 1),
    "05": ("BROAD-1", 2),
    "07": ("BROAD-1", 3),
    "24": ("BROAD-2", 1),
    "03": ("BROAD-2", 2),
    "33": ("BROAD-3", 1),
}
SAME_UNIT = (("02", "05", "07"), ("24", "03"))


def trial(measured: MeasuredSets, name: str) -> CalibrationDocument:
    """The calibration made of one trial."""
    return measured.calibration(*VERSIONS[name])


def broad_found(measured: MeasuredSets) -> str:
    """What each trial gives by itself."""
    return findings({f"trial {name}": trial(measured, name) for name in VERSIONS})


def broad_doubts(measured: MeasuredSets) -> str:
    """What the solver says against its own results."""
    return reasons({f"trial {name}": trial(measured, name) for name in VERSIONS})


def broad_gains(measured: MeasuredSets) -> str:
    """How far the gains of trials of one unit lie apart."""
    rows = []
    for unit in SAME_UNIT:
        for first, other in combinations(unit, 2):
            (gain_1, std_1), (gain_2, std_2) = (
                gain_and_std(trial(measured, name)) for name in (first, other)
            )
            apart, std = gain_2 - gain_1, np.hypot(std_1, std_2)
            i, j = np.unravel_index(np.argmax(np.abs(apart)), apart.shape)
            rows.append(
                [
                    f"trial {other} minus trial {first}",
                    f"{'xyz'[i]}{'xyz'[j]}",
                    f"{number(MILLI * float(apart[i, j]), 2)}"
                    f" ± {number(MILLI * float(std[i, j]), 2)}",
                    number(float(np.sqrt(np.mean((apart / std) ** 2))), 2),
                ]
            )
    head = [
        "gains of",
        "entry with the largest difference",
        "difference, 1e-3",
        "rms of the nine differences / std",
    ]
    return table(head, rows)


def broad_bias(measured: MeasuredSets) -> str:
    """The fitted bias and the mean of the rests of the same trial."""
    rows = []
    for name in VERSIONS:
        bias, std = value_and_std(trial(measured, name), "bias")
        rest = rest_bias(measured.load(name))
        cells = [
            f"{number(np.degrees(float(b)), 3)} ± {number(np.degrees(float(s)), 3)}"
            f" / {number(np.degrees(float(r)), 3)}"
            for b, s, r in zip(bias, std, rest, strict=True)
        ]
        rows.append([name, *cells])
    return table(["trial", *(f"{a}, fitted / at rest, °/s" for a in "xyz")], rows)


def rest_bias(loaded: LoadedRecording) -> FloatArray:
    """The mean rate of a trial's rests."""
    # The mean: these gyros count in steps of 0.061 deg/s, and a median is one of the steps.
    still = loaded.at_rest(loaded.samples.time_s)
    return np.asarray(loaded.samples.rate_rad_s[still].mean(axis=0), np.float64)


def fit_of(measured: MeasuredSets, name: str) -> tuple[float, FloatArray, FloatArray]:
    """Time offset in s, bias and gain of one trial's fit."""
    calibration = trial(measured, name)
    offset_s = float(value_and_std(calibration, "time_offset")[0][0])
    return offset_s, value_and_std(calibration, "bias")[0], gain_and_std(calibration)[0]


def car_found(measured: MeasuredSets) -> str:
    """The phone's gyro with the camera's pose as the reference."""
    return findings({"with the pose": measured.calibration("COMMA-PHONE")})


def car_doubts(measured: MeasuredSets) -> str:
    """Why the pose is distrusted."""
    return reasons({"pose": measured.calibration("COMMA-PHONE")})


def car_refused(measured: MeasuredSets) -> str:
    """What is no gyro data."""
    return refusals(measured.runs["car-imu-can"])
