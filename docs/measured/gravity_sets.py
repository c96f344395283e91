"""`imu_tk_xsens` and `mpu6050_raw_counts`: gravity between rests as the only reference."""

import numpy as np
from docs.markdown import number, table
from docs.measured.held_out_moves import OFFSET_COUNTS
from docs.measured.printed import (
    IMU_CALIBRATION_BIAS_COUNTS,
    IMU_CALIBRATION_SCALE_RAD_S,
    IMU_TK,
)
from docs.measured.sessions import MeasuredSets, gain_and_std, value_and_std
from docs.measured.tables import AXES, findings, gains_beside, reasons, untold

from gyrorig_solver.calibration.calibration_wording import value_std_pairs
from gyrorig_solver.data import FloatArray
from gyrorig_solver.model import PARAMETER_GROUPS, factorise, format_quantity


def xsens_found(measured: MeasuredSets) -> str:
    """The result and that of imu_tk, in the same factors."""
    calibration = measured.calibration("XSENS-MTI")
    scale_rad_s = _scale_rad_s(measured, "xsens")
    theirs = _factors(IMU_TK.gain(scale_rad_s))
    spread = IMU_TK.spread(_factors, scale_rad_s)
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
            its = " ± ".join(format_quantity(other * group.factor, other_std * group.factor))
            unit = "" if group.unit == "1" else f", {group.unit}"
            off = number((value - other) / float(np.hypot(std, other_std)), 2)
            rows.append([f"{group.name} {label}{unit}", ours, its, off])
    return table(["parameter", "gyrorig", "imu_tk", "difference / combined std"], rows)


def _factors(gain: FloatArray) -> FloatArray:
    """Scale, non-orthogonality and misalignment in one vector."""
    factors = factorise(gain)
    return np.concatenate([factors.scale, factors.nonorthogonality, factors.misalignment_rad])


def xsens_gains(measured: MeasuredSets) -> str:
    """The nine gains and those of imu_tk."""
    ours = gain_and_std(measured.calibration("XSENS-MTI"))
    theirs = IMU_TK.gain(_scale_rad_s(measured, "xsens"))
    return gains_beside(ours, theirs, ("gyrorig", "imu_tk"), 5)


def xsens_bias(measured: MeasuredSets) -> str:
    """The bias and the two biases of imu_tk."""
    scale = _scale_rad_s(measured, "xsens")
    bias, std = value_and_std(measured.calibration("XSENS-MTI"), "bias")
    held = np.degrees((IMU_TK.b_counts - OFFSET_COUNTS) * scale)
    freed = np.degrees((IMU_TK.bias_freed_counts - OFFSET_COUNTS) * scale)
    loaded = measured.load("xsens")
    begun = loaded.at_rest(loaded.samples.time_s)  # the map names the first 50 s only
    first = np.degrees(loaded.samples.rate_rad_s[begun].mean(axis=0))
    rows = [
        [
            AXES[i],
            f"{number(np.degrees(bias[i]), 4)} ± {number(np.degrees(std[i]), 4)}",
            number(first[i], 4),
            number(held[i], 4),
            number(freed[i], 4),
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


def xsens_doubts(measured: MeasuredSets) -> str:
    """What this session does not determine."""
    return reasons({"session": measured.calibration("XSENS-MTI")})


def raw_counts_found(measured: MeasuredSets) -> str:
    """The rest and the poses."""
    return findings(
        {
            "at rest": measured.calibration("MPU6050-RAW", 1),
            "poses": measured.calibration("MPU6050-RAW", 2),
        }
    )


def raw_counts_untold(measured: MeasuredSets) -> str:
    """The parameters without a value."""
    rows = [
        [title, untold(measured.calibration("MPU6050-RAW", version))]
        for title, version in (("at rest", 1), ("poses", 2))
    ]
    return table(["recording", "no value"], rows)


def raw_counts_doubts(measured: MeasuredSets) -> str:
    """The reasons."""
    return reasons(
        {
            "at rest": measured.calibration("MPU6050-RAW", 1),
            "poses": measured.calibration("MPU6050-RAW", 2),
        }
    )


def raw_counts_beside(measured: MeasuredSets) -> str:
    """The result of the poses and that in the authors' repository."""
    scale = _scale_rad_s(measured, "poses")
    calibration = measured.calibration("MPU6050-RAW", 2)
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
            ours, apart = "-", "-"
            if value is not None and std is not None:
                text, spread = format_quantity(value * group.factor, std * group.factor)
                ours = f"{text} ± {spread}"
                apart = number((value * group.factor - float(other)) / (std * group.factor), 2)
            unit = "" if group.unit == "1" else f", {group.unit}"
            rows.append([f"{group.name} {label}{unit}", ours, number(float(other), 4), apart])
    return table(["parameter", "gyrorig", "ImuCalibration", "difference / std"], rows)


def _scale_rad_s(measured: MeasuredSets, name: str) -> float:
    return measured.load(name).samples.quantum_rad_s
