"""The categories that describe a cause: part, kind, scope, stage, roles and covariates.

What to use when: for the card of a cause, and to select causes by category.
"""

from typing import Literal, get_args

Part = Literal["clock", "link", "sensor", "ptu", "mount", "environment"]
# effect: changes the measured rate. known: changes it by an amount that is known in advance. gauge:
# the base parameters absorb it completely, so a residual never shows it. stochastic: changes the
# noise, not the mean. raw: visible in the raw stream, not in a model.
Kind = Literal["effect", "known", "gauge", "stochastic", "raw"]
# A unit's cause is common to all boards on that unit. A recording's cause is absent from the
# next recording.
Scope = Literal["board", "unit", "recording"]
# size: the magnitude, zero means no effect. shape, event: a nuisance that has no meaning at
# size zero (a period, a lag, a time constant; a time). It is scanned before it is refined.
Role = Literal["size", "shape", "event"]
# Stage between the motor command and the timestamped sample at which a cause acts. Later stages act
# on the result of earlier ones: backlash acts on a motion whose ramps are already rounded.
Stage = Literal[
    "profile",  # the moves that the controller plans
    "motor",  # how the motor executes them
    "rotor",  # steps that the motor loses
    "drive",  # from steps to the turn of the worm
    "play",  # from worm to wheel
    "wheel",  # the turn of the wheel
    "stage",  # the structure on the wheel, and the structure below the unit
    "axes",  # from the turn of the axes to the rate of the stage
    "mount",  # from stage to sensor
    "sensor",  # the response of the sensing element
    "threshold",  # its response to small rates
    "bias",  # its output without rotation
    "low_pass",
    "limit",  # the largest output
    "clock",  # the time of sampling
    "readout",  # the value that is written; nothing follows
]
SIGNAL_PATH: tuple[Stage, ...] = get_args(Stage)
# These stages filter or delay the signal of all other causes. The effect of the other causes is
# exact if it is computed with these stages included.
FILTER_STAGES: tuple[Stage, ...] = ("low_pass", "clock")

# Predictors of the smooth functions that a cause is tested against; see
# `discover.checks.specification_tests`.
EDGE_COVARIATES = ("pan_transient", "tilt_transient", "move_gain", "move_delay")
ANGLE_COVARIATES = ("pan_angle", "tilt_angle")
RATE_COVARIATES = ("own_rate", "speed")
BRIEF_COVARIATES = ("pan_transient", "tilt_transient", "move_gain")

Quantity = Literal["mean", "gain", "lag"]
# grid: some rows of the template bank first. full_grid: all rows. pulses, spectral_lines: rows
# at the strongest pulses or lines of the residual. lag_series: rows that fit the lag by time.
TemplateSearch = Literal["grid", "full_grid", "pulses", "spectral_lines", "lag_series"]
