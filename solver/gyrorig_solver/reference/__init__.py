"""Reference motions, with which the rates of a sensor are compared.

What to use when: `reference_motion.ReferenceMotion` is the interface that the estimator uses.
`unit` reconstructs the motion of a pan-tilt unit; `attitude_reference` uses measured attitudes,
`known_turns` turns by known angles, `gravity_reference` gravity between rests, and
`rest_reference` a board at rest. `rotations` has the rotation algebra.
"""

from gyrorig_solver.reference.attitude_reference import (
    MAX_BRIDGED_S,
    AttitudeReference,
    read_attitude,
)
from gyrorig_solver.reference.gravity_reference import StaticPoses, find_poses
from gyrorig_solver.reference.known_turns import TimeInterval, TurnReference, read_turns
from gyrorig_solver.reference.reference_motion import ReferenceMotion
from gyrorig_solver.reference.rest_reference import RestReference, mostly_at_rest
from gyrorig_solver.reference.rotations import path_product, prefix_products, turn_vectors
from gyrorig_solver.reference.unit.law_information import LawProfile
from gyrorig_solver.reference.unit.motion_law import LAW_QUANTITIES, LAW_VALUES, MotionLaw
from gyrorig_solver.reference.unit.motion_profile import MotionLimits, MotionProfile, plan_motion
from gyrorig_solver.reference.unit.pan_tilt_recording import (
    UNUSABLE_STATUS,
    read_pan_tilt_reference,
)
from gyrorig_solver.reference.unit.pan_tilt_reference import PanTiltReference
from gyrorig_solver.reference.unit.rest_variance import DETENT_VARIANCE
from gyrorig_solver.reference.unit.stage_kinematics import StageRateJacobian

__all__ = [
    "DETENT_VARIANCE",
    "LAW_QUANTITIES",
    "LAW_VALUES",
    "MAX_BRIDGED_S",
    "UNUSABLE_STATUS",
    "AttitudeReference",
    "LawProfile",
    "MotionLaw",
    "MotionLimits",
    "MotionProfile",
    "PanTiltReference",
    "ReferenceMotion",
    "RestReference",
    "StageRateJacobian",
    "StaticPoses",
    "TimeInterval",
    "TurnReference",
    "find_poses",
    "mostly_at_rest",
    "path_product",
    "plan_motion",
    "prefix_products",
    "read_attitude",
    "read_pan_tilt_reference",
    "read_turns",
    "turn_vectors",
]
