"""Statistics of a fleet: populations, differences between groups, outliers and drift.

What to use when: `fleet_overview.build_overview` for everything; `population` for mean and spread
of one parameter, `ewma_charts` for drift, `common_offsets` for errors that all units share,
`shrinkage_files` to store the shrinkage estimates.
"""

from gyrorig_solver.fleet.drift.common_offsets import OffsetComparison, describe_offsets
from gyrorig_solver.fleet.drift.fleet_overview import (
    PARAMETER_COLUMNS,
    FleetOverview,
    build_overview,
)
from gyrorig_solver.fleet.drift.group_statistics import groups_as_json

__all__ = [
    "PARAMETER_COLUMNS",
    "FleetOverview",
    "OffsetComparison",
    "build_overview",
    "describe_offsets",
    "groups_as_json",
]
