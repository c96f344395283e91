"""`broad` and `car_imu_can`: gyros beside a reference attitude."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from docs.markdown import number, table
from docs.measured.sessions import Loaded, Measured, gain_and_std, value_and_std
from docs.measured.tables import MILLI, findings, reasons, refusals

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.calibration.document import Calibration
from gyrorig_solver.estimate.rotation import RotationError, window_rotation_error

WINDOW_S = 1.0
# trial: (board, version) as the page's commands make them
VERSIONS = {
    "02": ("BROAD-1", 1),
    "05": ("BROAD-1", 2),
    "07": ("BROAD-1", 3),
    "24": ("BROAD-2", 1),
    "03": ("BROAD-2", 2),
}
SAME_UNIT = (("02", "05", "07"), ("24", "03"))
HELD_OUT = (("02", "07"), ("02", "05"), ("24", "03"))  # fitted on, judged on


def trial(measured: Measured, name: str) -> Calibration:
    """The calibration made of one trial."""
    return measured.calibration(*VERSIONS[name])


def broad_found(measured: Measured) -> str:
    """What each trial gives by itself."""
    return findings({name: trial(measured, name) for name in VERSIONS})


def broad_doubts(measured: Measured) -> str:
    """What the solver says against its own results."""
    return reasons({name: trial(measured, name) for name in VERSIONS})


def broad_gains(measured: Measured) -> str:
    """How far the gains of trials of one unit lie apart."""
    rows = []
    for unit in SAME_UNIT:
        for one, other in combinations(unit, 2):
            (gain_1, std_1), (gain_2, std_2) = (
                gain_and_std(trial(measured, name)) for name in (one, other)
            )
            apart, std = gain_2 - gain_1, np.hypot(std_1, std_2)
            i, j = np.unravel_index(np.argmax(np.abs(apart)), apart.shape)
            rows.append(
                [
                    f"{other} - {one}",
                    f"{'xyz'[i]}{'xyz'[j]}",
                    f"{number(MILLI * float(apart[i, j]), 2)}"
                    f" ± {number(MILLI * float(std[i, j]), 2)}",
                    number(float(np.sqrt(np.mean((apart / std) ** 2))), 2),
                ]
            )
    head = ["gains of", "entry furthest apart", "apart by, 1e-3", "rms of the nine / std"]
    return table(head, rows)


def broad_bias(measured: Measured) -> str:
    """The fitted bias beside the mean of the rests of the same trial."""
    rows = []
    for name in VERSIONS:
        bias, std = value_and_std(trial(measured, name), "bias")
        rest = _rest_bias(measured.load(name))
        cells = [
            f"{number(np.degrees(float(b)), 3)} ± {number(np.degrees(float(s)), 3)}"
            f" / {number(np.degrees(float(r)), 3)}"
            for b, s, r in zip(bias, std, rest, strict=True)
        ]
        rows.append([name, *cells])
    return table(["trial", *(f"{a}, fitted / at rest, °/s" for a in "xyz")], rows)


def _rest_bias(loaded: Loaded) -> FloatArray:
    # The mean: these gyros count in steps of 0.061 deg/s, and a median is one of the steps.
    still = loaded.at_rest(loaded.samples.time_s)
    return np.asarray(loaded.samples.rate_rad_s[still].mean(axis=0), np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """One way of using a gyro: what is taken from the fit."""

    words: str
    offset_s: float
    bias_rad_s: FloatArray
    gain: FloatArray


def broad_held_out(measured: Measured) -> str:
    """Rotation error on trials that the fit has not seen."""
    rows = []
    for train, test in HELD_OUT:
        loaded = measured.load(test)
        errors = {way.words: _error(loaded, way) for way in _ways(measured, train, test, loaded)}
        lagged = errors["time offset"].angle_rad
        for words, error in errors.items():
            low, high = np.degrees(error.interval_rad)
            closer = 100.0 * float(np.mean(error.angle_rad < lagged))
            rows.append(
                [
                    f"{train} → {test}",
                    words,
                    number(float(np.degrees(error.rms_rad)), 3),
                    f"{number(low, 3)} to {number(high, 3)}",
                    number(float(np.degrees(error.median_rad)), 3),
                    "" if words == "time offset" else number(closer, 0),
                    str(error.angle_rad.size),
                ]
            )
    head = ["fitted → judged on", "used of the fit", "rms, °", "95 %, °", "median, °"]
    return table([*head, "closer than with time offset only, %", "windows"], rows)


def _ways(measured: Measured, train: str, test: str, loaded: Loaded) -> list[_Way]:
    offset_s, bias, gain = _fit(trial(measured, train))
    own_offset_s, own_bias, own_gain = _fit(trial(measured, test))
    rest, nominal = _rest_bias(loaded), np.eye(3)
    return [
        _Way("nothing (raw)", 0.0, rest, nominal),
        _Way("time offset", offset_s, rest, nominal),
        _Way("time offset, gain", offset_s, rest, gain),
        _Way("all: calibrated", offset_s, bias, gain),
        _Way(f"(the fit of {test} itself)", own_offset_s, own_bias, own_gain),
    ]


def _fit(calibration: Calibration) -> tuple[float, FloatArray, FloatArray]:
    offset_s = float(value_and_std(calibration, "time_offset")[0][0])
    return offset_s, value_and_std(calibration, "bias")[0], gain_and_std(calibration)[0]


def _error(loaded: Loaded, way: _Way) -> RotationError:
    samples, attitude = loaded.samples, loaded.attitude
    if attitude is None:
        raise ValueError(f"{samples.board} has no reference attitude")
    rate = (samples.rate_rad_s - way.bias_rad_s) @ np.linalg.inv(way.gain).T
    moving = ~loaded.at_rest(attitude.time_s)
    return window_rotation_error(samples.time_s - way.offset_s, rate, attitude, WINDOW_S, moving)


def car_found(measured: Measured) -> str:
    """The phone's gyro beside the camera's pose."""
    return findings({"beside the pose": measured.calibration("COMMA-PHONE")})


def car_doubts(measured: Measured) -> str:
    """Why the pose is distrusted."""
    return reasons({"pose": measured.calibration("COMMA-PHONE")})


def car_refused(measured: Measured) -> str:
    """What is no gyro data."""
    return refusals(measured.done["car-imu-can"])
