"""Statistics of a fleet: populations, differences between groups, outliers and drift.

What to use when: `fleet_overview.build_overview` for everything; `population` for mean and spread
of one parameter, `ewma_charts` for drift, `common_offsets` for errors that all units share,
`shrinkage_files` to store the shrinkage estimates.
"""
