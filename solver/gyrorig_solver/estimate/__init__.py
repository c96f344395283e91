"""The estimators: from samples and a reference motion to gain, bias, delay and causes.

What to use when:

- `motion_fit.fit_motion` and `fit_recordings` for a board on a pan-tilt unit or at rest;
  `multi_board_fit` for several boards that were on one unit at the same time.
- `attitude.attitude_summary`, `turn_fit` and `gravity_fit` for the other references.
- `likelihood_fit` for the fit of one or more boards, `board_fit` for one board, `session_fit` for
  one recording; `parameter_layout` for the order of their parameters.
- `fitted_term` and `cascade` for causes in a fit.
- `nuisance_projector` for score tests at a fit.
- `observability` for the directions that the data determine; `gyro_fit` for the result of every
  method.
- `temperature` for the bias over temperature.
- `noise` for the noise model and outliers, `linear` for the normal equations, `paper` for the
  method of the paper.
"""

from gyrorig_solver.estimate.attitude.attitude_conventions import (
    judge_conventions,
    mirrored_gain,
)
from gyrorig_solver.estimate.attitude.attitude_projector import AttitudeProjector
from gyrorig_solver.estimate.attitude.attitude_summary import fit_attitude
from gyrorig_solver.estimate.cascade import total_effect
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.derived_parameters import derive_parameters
from gyrorig_solver.estimate.executed_motion import reference_cost
from gyrorig_solver.estimate.factor_covariance import propagate_to_factors
from gyrorig_solver.estimate.fitted_term import FittedTerm, GaussianPrior, free_term
from gyrorig_solver.estimate.gravity_fit import fit_gravity
from gyrorig_solver.estimate.gyro_fit import (
    NO_SHARING,
    BoardSharing,
    ClockQuality,
    FitDiagnostics,
    GyroFit,
    ObservabilityReport,
)
from gyrorig_solver.estimate.information import (
    PARAMETER_NAMES,
    marginalise,
    white_noise_information,
)
from gyrorig_solver.estimate.likelihood_fit import (
    MAX_EVALUATIONS,
    confirm_fit,
    fit_likelihood,
    refit_with_terms,
)
from gyrorig_solver.estimate.linear.whitening import BASE_PARAMETERS
from gyrorig_solver.estimate.motion_fit import fit_motion
from gyrorig_solver.estimate.multi_board_fit import fit_boards_jointly
from gyrorig_solver.estimate.noise.noise_levels import (
    PRIOR_LOG_STD,
    fit_noise_levels,
    nominal_levels,
)
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, Sampling, unit_densities
from gyrorig_solver.estimate.noise.residual_spectrum import Periodogram, Spectrum, bin_spectrum
from gyrorig_solver.estimate.nuisance_projector import LawStatistics, NuisanceProjector
from gyrorig_solver.estimate.nuisance_space import ScoreStatistics
from gyrorig_solver.estimate.observability import (
    PRIOR_STD,
    ObservabilityAnalysis,
    analyse_observability,
)
from gyrorig_solver.estimate.observability_remedies import REST_REMEDIES, UNIT_REMEDIES
from gyrorig_solver.estimate.paper.paper_method import calibrate_as_printed
from gyrorig_solver.estimate.parameter_layout import (
    GAIN_PARAMETERS,
    SESSION_PARAMETERS,
    ParameterLayout,
)
from gyrorig_solver.estimate.sample_averaging import mean_duration_s
from gyrorig_solver.estimate.segment_signals import SignalCount, SignalFunction
from gyrorig_solver.estimate.series import Series, build_series, choose_grids
from gyrorig_solver.estimate.session_fit import SessionFit
from gyrorig_solver.estimate.shared_parameters import (
    MIN_HOMOGENEITY_P,
    homogeneity_p_values,
    is_unit_cause,
)
from gyrorig_solver.estimate.temperature.temperature_fit import TemperatureFit, fit_temperature
from gyrorig_solver.estimate.trust_region import Convergence
from gyrorig_solver.estimate.turn_fit import fit_turns
from gyrorig_solver.estimate.typical_board import TYPICAL_MOUNT, expected_estimate
from gyrorig_solver.estimate.uncertainty_widening import widen_uncertainty
from gyrorig_solver.estimate.whitened_signals import WhitenedSignals, join_signals

__all__ = [
    "BASE_PARAMETERS",
    "GAIN_PARAMETERS",
    "MAX_EVALUATIONS",
    "MIN_HOMOGENEITY_P",
    "NO_SHARING",
    "PARAMETER_NAMES",
    "PRIOR_LOG_STD",
    "PRIOR_STD",
    "REST_REMEDIES",
    "SESSION_PARAMETERS",
    "TYPICAL_MOUNT",
    "UNIT_REMEDIES",
    "AttitudeProjector",
    "BoardSharing",
    "ClockQuality",
    "ConvergedFit",
    "Convergence",
    "FitDiagnostics",
    "FittedTerm",
    "GaussianPrior",
    "GyroFit",
    "LawStatistics",
    "NoiseModel",
    "NuisanceProjector",
    "ObservabilityAnalysis",
    "ObservabilityReport",
    "ParameterLayout",
    "Periodogram",
    "Sampling",
    "ScoreStatistics",
    "Series",
    "SessionFit",
    "SignalCount",
    "SignalFunction",
    "Spectrum",
    "TemperatureFit",
    "WhitenedSignals",
    "analyse_observability",
    "bin_spectrum",
    "build_series",
    "calibrate_as_printed",
    "choose_grids",
    "confirm_fit",
    "derive_parameters",
    "expected_estimate",
    "fit_attitude",
    "fit_boards_jointly",
    "fit_gravity",
    "fit_likelihood",
    "fit_motion",
    "fit_noise_levels",
    "fit_temperature",
    "fit_turns",
    "free_term",
    "homogeneity_p_values",
    "is_unit_cause",
    "join_signals",
    "judge_conventions",
    "marginalise",
    "mean_duration_s",
    "mirrored_gain",
    "nominal_levels",
    "propagate_to_factors",
    "reference_cost",
    "refit_with_terms",
    "total_effect",
    "unit_densities",
    "white_noise_information",
    "widen_uncertainty",
]
