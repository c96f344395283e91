"""Tables of `imu_tk_xsens` and `mpu6050_raw_counts`, with gravity as the only reference."""

import numpy as np
from docs.markdown import number, table
from docs.measured.held_out_moves import OFFSET_COUNTS
from docs.measured.printed import (
    IMU_CALIBRATION_BIAS_COUNTS,
    IMU_CALIBRATION_SCALE_RAD_S,
    IMU_TK,
)
from docs.measured.sessions import MeasuredSets, compute_gain_and_std, read_value_and_std
from docs.measured.tables import AXES, compare_gains, list_unobservable, reasons, results

from gyrorig_solver.calibration.calibration_wording import value_std_pairs
from gyrorig_solver.data import FloatArray
from gyrorig_solver.model import PARAMETER_GROUPS, factorise, format_quantity


def xsens_results(measured: MeasuredSets) -> str:
    """Return the factors of our gain and of the gain of imu_tk."""
    calibration = measured.read_calibration("XSENS-MTI")
    scale_rad_s = _read_scale_rad_s(measured, "xsens")
    theirs = _factor_vector(IMU_TK.compute_gain(scale_rad_s))
    spread = IMU_TK.propagate_std(_factor_vector, scale_rad_s)
    rows, at = [], 0
    for group in PARAMETER_GROUPS:
        if group.name not in ("scale", "nonorthogonality", "misalignment"):
            continue
        for label, (value, std) in zip(
            group.labels, value_std_pairs(calibration.parameters[group.name]), strict=True
        ):
            if value is None or std is None:
                raise ValueError(f"{group.name} {label} has no value")
            other, other_std = float(theirs[at]), float(spread[at])
            at += 1
            ours = " ± ".join(format_quantity(value * group.factor, std * group.factor))
            theirs_text = " ± ".join(
                format_quantity(other * group.factor, other_std * group.factor)
            )
            unit = "" if group.unit == "1" else f", {group.unit}"
            difference = number((value - other) / float(np.hypot(std, other_std)), 2)
            rows.append([f"{group.name} {label}{unit}", ours, theirs_text, difference])
    return table(["parameter", "gyrorig", "imu_tk", "difference / combined std"], rows)


def _factor_vector(gain: FloatArray) -> FloatArray:
    """Return scale, non-orthogonality and misalignment in one vector."""
    factors = factorise(gain)
    return np.concatenate([factors.scale, factors.nonorthogonality, factors.misalignment_rad])


def xsens_gains(measured: MeasuredSets) -> str:
    """Return our nine gains and those of imu_tk."""
    ours = compute_gain_and_std(measured.read_calibration("XSENS-MTI"))
    theirs = IMU_TK.compute_gain(_read_scale_rad_s(measured, "xsens"))
    return compare_gains(ours, theirs, ("gyrorig", "imu_tk"), 5)


def xsens_bias(measured: MeasuredSets) -> str:
    """Return our bias and the two biases of imu_tk."""
    scale = _read_scale_rad_s(measured, "xsens")
    bias, std = read_value_and_std(measured.read_calibration("XSENS-MTI"), "bias")
    first_rest = np.degrees((IMU_TK.b_counts - OFFSET_COUNTS) * scale)
    fitted = np.degrees((IMU_TK.fitted_bias_counts - OFFSET_COUNTS) * scale)
    loaded = measured.load_recording("xsens")
    # The import map has only one rest, the first 50 s.
    is_at_rest = loaded.make_rest_mask(loaded.samples.time_s)
    first_mean = np.degrees(loaded.samples.rate_rad_s[is_at_rest].mean(axis=0))
    rows = [
        [
            AXES[i],
            f"{number(np.degrees(bias[i]), 4)} ± {number(np.degrees(std[i]), 4)}",
            number(first_mean[i], 4),
            number(first_rest[i], 4),
            number(fitted[i], 4),
        ]
        for i in range(3)
    ]
    titles = [
        "gyrorig, °/s",
        "mean of the first 50 s, °/s",
        "imu_tk, first rest, °/s",
        "imu_tk, bias fitted too, °/s",
    ]
    return table(["axis", *titles], rows)


def xsens_reasons(measured: MeasuredSets) -> str:
    """Return the reasons and remarks of the solver for this session."""
    return reasons({"session": measured.read_calibration("XSENS-MTI")})


def raw_counts_results(measured: MeasuredSets) -> str:
    """Return the calibrations from the rest and from the poses."""
    return results(
        {
            "at rest": measured.read_calibration("MPU6050-RAW", 1),
            "poses": measured.read_calibration("MPU6050-RAW", 2),
        }
    )


def raw_counts_unobservable(measured: MeasuredSets) -> str:
    """Return the parameters without a value."""
    rows = [
        [title, list_unobservable(measured.read_calibration("MPU6050-RAW", version))]
        for title, version in (("at rest", 1), ("poses", 2))
    ]
    return table(["recording", "no value"], rows)


def raw_counts_reasons(measured: MeasuredSets) -> str:
    """Return the reasons and remarks of the solver."""
    return reasons(
        {
            "at rest": measured.read_calibration("MPU6050-RAW", 1),
            "poses": measured.read_calibration("MPU6050-RAW", 2),
        }
    )


def raw_counts_comparison(measured: MeasuredSets) -> str:
    """Return our result from the poses and the result in the repository of the authors."""
    scale = _read_scale_rad_s(measured, "poses")
    calibration = measured.read_calibration("MPU6050-RAW", 2)
    theirs_bias = np.degrees(IMU_CALIBRATION_BIAS_COUNTS * scale)
    theirs_scale = scale / IMU_CALIBRATION_SCALE_RAD_S
    rows = []
    for group in PARAMETER_GROUPS:
        if group.name not in ("bias", "scale"):
            continue
        theirs = theirs_bias if group.name == "bias" else theirs_scale
        for label, (value, std), other in zip(
            group.labels, value_std_pairs(calibration.parameters[group.name]), theirs, strict=True
        ):
            ours, difference = "-", "-"
            if value is not None and std is not None:
                text, spread = format_quantity(value * group.factor, std * group.factor)
                ours = f"{text} ± {spread}"
                difference = number((value * group.factor - float(other)) / (std * group.factor), 2)
            unit = "" if group.unit == "1" else f", {group.unit}"
            rows.append([f"{group.name} {label}{unit}", ours, number(float(other), 4), difference])
    return table(["parameter", "gyrorig", "ImuCalibration", "difference / std"], rows)


def _read_scale_rad_s(measured: MeasuredSets, name: str) -> float:
    return measured.load_recording(name).samples.quantum_rad_s
