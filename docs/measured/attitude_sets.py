"""Tables of `broad` and `car_imu_can`, the sets with a reference attitude."""

from itertools import combinations

import numpy as np
from docs.markdown import number, table
from docs.measured.sessions import (
    LoadedRecording,
    MeasuredSets,
    compute_gain_and_std,
    read_value_and_std,
)
from docs.measured.tables import MILLI, reasons, refusals, results

from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.data import FloatArray

# trial: board and version of the calibration that the commands of the page make
VERSIONS = {
    "02": ("BROAD-1", 1),
    "05": ("BROAD-1", 2),
    "07": ("BROAD-1", 3),
    "24": ("BROAD-2", 1),
    "03": ("BROAD-2", 2),
    "33": ("BROAD-3", 1),
}
SAME_UNIT = (("02", "05", "07"), ("24", "03"))


def read_trial_calibration(measured: MeasuredSets, name: str) -> CalibrationDocument:
    """Return the calibration from one trial."""
    return measured.read_calibration(*VERSIONS[name])


def broad_results(measured: MeasuredSets) -> str:
    """Return the calibration of each trial."""
    return results({f"trial {name}": read_trial_calibration(measured, name) for name in VERSIONS})


def broad_reasons(measured: MeasuredSets) -> str:
    """Return the reasons and remarks of the solver for each trial."""
    return reasons({f"trial {name}": read_trial_calibration(measured, name) for name in VERSIONS})


def broad_gains(measured: MeasuredSets) -> str:
    """Return the differences between the gains of trials of one unit."""
    rows = []
    for unit in SAME_UNIT:
        for first, other in combinations(unit, 2):
            (gain_1, std_1), (gain_2, std_2) = (
                compute_gain_and_std(read_trial_calibration(measured, name))
                for name in (first, other)
            )
            difference, std = gain_2 - gain_1, np.hypot(std_1, std_2)
            i, j = np.unravel_index(np.argmax(np.abs(difference)), difference.shape)
            rows.append(
                [
                    f"trial {other} minus trial {first}",
                    f"{'xyz'[i]}{'xyz'[j]}",
                    f"{number(MILLI * float(difference[i, j]), 2)}"
                    f" ± {number(MILLI * float(std[i, j]), 2)}",
                    number(float(np.sqrt(np.mean((difference / std) ** 2))), 2),
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
    """Return the fitted bias and the mean rate at rest of each trial."""
    rows = []
    for name in VERSIONS:
        bias, std = read_value_and_std(read_trial_calibration(measured, name), "bias")
        rest_rad_s = compute_rest_bias(measured.load_recording(name))
        cells = [
            f"{number(np.degrees(float(b)), 3)} ± {number(np.degrees(float(s)), 3)}"
            f" / {number(np.degrees(float(r)), 3)}"
            for b, s, r in zip(bias, std, rest_rad_s, strict=True)
        ]
        rows.append([name, *cells])
    return table(["trial", *(f"{a}, fitted / at rest, °/s" for a in "xyz")], rows)


def compute_rest_bias(loaded: LoadedRecording) -> FloatArray:
    """Return the mean rate of the rests of a trial."""
    # A median would be a multiple of the resolution, 0.061 deg/s.
    is_at_rest = loaded.make_rest_mask(loaded.samples.time_s)
    return np.asarray(loaded.samples.rate_rad_s[is_at_rest].mean(axis=0), np.float64)


def read_fit(measured: MeasuredSets, name: str) -> tuple[float, FloatArray, FloatArray]:
    """Return the time offset in s, the bias and the gain of the fit of one trial."""
    calibration = read_trial_calibration(measured, name)
    offset_s = float(read_value_and_std(calibration, "time_offset")[0][0])
    return (
        offset_s,
        read_value_and_std(calibration, "bias")[0],
        compute_gain_and_std(calibration)[0],
    )


def car_results(measured: MeasuredSets) -> str:
    """Return the calibration of the phone's gyro with the pose of the camera as the reference."""
    return results({"with the pose": measured.read_calibration("COMMA-PHONE")})


def car_reasons(measured: MeasuredSets) -> str:
    """Return the reasons and remarks of the solver for the pose."""
    return reasons({"pose": measured.read_calibration("COMMA-PHONE")})


def car_refusals(measured: MeasuredSets) -> str:
    """Return the rejected input, which contains no gyro data."""
    return refusals(measured.runs["car-imu-can"])
