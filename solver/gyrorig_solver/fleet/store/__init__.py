"""Store of a fleet: calibrations, their index, journals, claims and manifests.

What to use when: `store_queries` to list and rebuild, `store_verification.verify` to check,
`index_rows.IndexRow` for one row of the index, `coordination` for the claims and the journal of a
batch, `manifest` for digests and signatures. A folder and a bucket are used in the same way.
"""

from gyrorig_solver.fleet.store.index_rows import (
    NEWEST_FIRST_SQL,
    UNSUCCESSFUL_ROWS_SQL,
    IndexRow,
    job_key,
    parameter_columns,
)
from gyrorig_solver.fleet.store.manifest import read_signer
from gyrorig_solver.fleet.store.store_index import StoreIndex
from gyrorig_solver.fleet.store.store_queries import open_existing_store, rebuild_index
from gyrorig_solver.fleet.store.store_verification import verify

__all__ = [
    "NEWEST_FIRST_SQL",
    "UNSUCCESSFUL_ROWS_SQL",
    "IndexRow",
    "StoreIndex",
    "job_key",
    "open_existing_store",
    "parameter_columns",
    "read_signer",
    "rebuild_index",
    "verify",
]
