"""The signal model: from the stage's motion to the samples, with all known causes of error.

What to use when: `gain_matrix` and `low_pass` for the sensor; `signal_state` for the signal at each
stage of the signal path; `term` for the interface of a cause, `term_kinds` for its base classes,
`causes` for the causes themselves and `catalogue` to find them; `leveling` for the tilt zero.
"""

from gyrorig_solver.model.board_temperature import BoardTemperature
from gyrorig_solver.model.catalogue import (
    cause_display_unit,
    cause_equation,
    find_term,
    term_of_law,
)
from gyrorig_solver.model.cause_categories import Part, Stage
from gyrorig_solver.model.gain_matrix import (
    FACTOR_NAMES,
    GAIN_NAMES,
    GainFactors,
    cross_matrix,
    factor_jacobian,
    factorise,
)
from gyrorig_solver.model.leveling import LevelEstimate
from gyrorig_solver.model.parameter_units import (
    DEG_PER_RAD,
    PARAMETER_GROUPS,
    ParameterGroup,
    display_unit,
    format_quantity,
    format_short,
    format_two_digits,
    group_of,
    parameter_label,
    plural,
)
from gyrorig_solver.model.recording_context import STANDARD_GRAVITY_M_S2, RecordingContext, Site
from gyrorig_solver.model.signal_arrays import (
    AxisBiases,
    Signals,
    dense_signals,
    split_axes,
    zero_signals,
)
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import (
    BinnedDependence,
    Term,
    TermParameter,
    components_of,
    start_values,
    value_indices,
    value_names,
    value_parameters,
)
from gyrorig_solver.model.term_form import form_for
from gyrorig_solver.model.term_instances import (
    is_active_in,
    limit_to_recording,
    occurrence_after,
    recording_index_of,
    term_label,
    value_labels,
)
from gyrorig_solver.model.term_kinds import LinearTerm
from gyrorig_solver.model.testability import why_not_computable, why_not_testable
from gyrorig_solver.model.value_format import DEG, XYZ, format_list

__all__ = [
    "DEG",
    "DEG_PER_RAD",
    "FACTOR_NAMES",
    "GAIN_NAMES",
    "PARAMETER_GROUPS",
    "STANDARD_GRAVITY_M_S2",
    "XYZ",
    "AxisBiases",
    "BinnedDependence",
    "BoardTemperature",
    "GainFactors",
    "LevelEstimate",
    "LinearTerm",
    "ParameterGroup",
    "Part",
    "RecordingContext",
    "SignalState",
    "Signals",
    "Site",
    "Stage",
    "Term",
    "TermParameter",
    "cause_display_unit",
    "cause_equation",
    "components_of",
    "cross_matrix",
    "dense_signals",
    "display_unit",
    "factor_jacobian",
    "factorise",
    "find_term",
    "form_for",
    "format_list",
    "format_quantity",
    "format_short",
    "format_two_digits",
    "group_of",
    "is_active_in",
    "limit_to_recording",
    "occurrence_after",
    "parameter_label",
    "plural",
    "recording_index_of",
    "split_axes",
    "start_values",
    "term_label",
    "term_of_law",
    "value_indices",
    "value_labels",
    "value_names",
    "value_parameters",
    "why_not_computable",
    "why_not_testable",
    "zero_signals",
]
