"""Every cause that an emulated rig can inject, by its id in the contract's catalogue."""

from collections.abc import Mapping
from types import MappingProxyType

from gyrorig_daemon.emulator.causes.acceleration_error import AccelerationError
from gyrorig_daemon.emulator.causes.axis_nonorthogonality import AxisNonorthogonality
from gyrorig_daemon.emulator.causes.axis_swap import AxisSwap
from gyrorig_daemon.emulator.causes.backlash import Backlash
from gyrorig_daemon.emulator.causes.base_compliance import BaseCompliance
from gyrorig_daemon.emulator.causes.base_speed_jump import BaseSpeedJump
from gyrorig_daemon.emulator.causes.bias_ramp import BiasRamp
from gyrorig_daemon.emulator.causes.bias_random_walk import BiasRandomWalk
from gyrorig_daemon.emulator.causes.bias_step import BiasStep
from gyrorig_daemon.emulator.causes.board_slip import BoardSlip
from gyrorig_daemon.emulator.causes.cause import Cause
from gyrorig_daemon.emulator.causes.clock_offset import ClockOffset
from gyrorig_daemon.emulator.causes.clock_skew import ClockSkew
from gyrorig_daemon.emulator.causes.clock_step import ClockStep
from gyrorig_daemon.emulator.causes.corrupt_samples import CorruptSamples
from gyrorig_daemon.emulator.causes.dead_zone import DeadZone
from gyrorig_daemon.emulator.causes.earth_rotation import EarthRotation
from gyrorig_daemon.emulator.causes.eccentricity import Eccentricity
from gyrorig_daemon.emulator.causes.g_sensitivity import GSensitivity
from gyrorig_daemon.emulator.causes.lost_samples import LostSamples
from gyrorig_daemon.emulator.causes.lost_steps import LostSteps
from gyrorig_daemon.emulator.causes.low_pass_lag import LowPassLag
from gyrorig_daemon.emulator.causes.motor_coupling import MotorCoupling
from gyrorig_daemon.emulator.causes.repeated_samples import RepeatedSamples
from gyrorig_daemon.emulator.causes.ringing import Ringing
from gyrorig_daemon.emulator.causes.s_curve import SCurve
from gyrorig_daemon.emulator.causes.sample_jitter import SampleJitter
from gyrorig_daemon.emulator.causes.saturation import Saturation
from gyrorig_daemon.emulator.causes.scale_asymmetry import ScaleAsymmetry
from gyrorig_daemon.emulator.causes.scale_cubic import ScaleCubic
from gyrorig_daemon.emulator.causes.scale_quadratic import ScaleQuadratic
from gyrorig_daemon.emulator.causes.sign_flip import SignFlip
from gyrorig_daemon.emulator.causes.step_resolution import StepResolution
from gyrorig_daemon.emulator.causes.supply_hum import SupplyHum
from gyrorig_daemon.emulator.causes.thermal_bias import ThermalBias
from gyrorig_daemon.emulator.causes.thermal_scale import ThermalScale
from gyrorig_daemon.emulator.causes.tilt_sag import TiltSag
from gyrorig_daemon.emulator.causes.tilt_zero import TiltZero
from gyrorig_daemon.emulator.causes.vibration_rectification import VibrationRectification
from gyrorig_daemon.emulator.causes.warm_up import WarmUp
from gyrorig_daemon.emulator.causes.worm_error import WormError
from gyrorig_daemon.emulator.causes.wrong_full_scale import WrongFullScale

CAUSES: Mapping[str, type[Cause]] = MappingProxyType(
    {
        cause.name: cause
        for cause in (
            ClockOffset,
            ClockSkew,
            ClockStep,
            LostSamples,
            RepeatedSamples,
            SampleJitter,
            CorruptSamples,
            AxisSwap,
            SignFlip,
            WrongFullScale,
            LowPassLag,
            ScaleQuadratic,
            ScaleCubic,
            ScaleAsymmetry,
            Saturation,
            DeadZone,
            GSensitivity,
            VibrationRectification,
            ThermalScale,
            MotorCoupling,
            ThermalBias,
            WarmUp,
            BiasRamp,
            BiasStep,
            BiasRandomWalk,
            SupplyHum,
            Backlash,
            LostSteps,
            Eccentricity,
            WormError,
            AxisNonorthogonality,
            TiltZero,
            StepResolution,
            AccelerationError,
            SCurve,
            BaseSpeedJump,
            Ringing,
            TiltSag,
            BaseCompliance,
            BoardSlip,
            EarthRotation,
        )
    }
)
