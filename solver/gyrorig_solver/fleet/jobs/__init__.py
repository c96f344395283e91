"""Jobs of a nightly batch: from the recordings of a spool folder to new calibrations.

What to use when: `batch_run.run_batch` for one batch; `workers.local_pools` or
`dask_workers.dask_pools` for the processes; `session_job.run_job` is the work on one session;
`spool_scanner` lists the recordings, and `recording_cache` remembers what they contain.
"""

from gyrorig_solver.fleet.jobs.batch_run import BatchSummary, run_batch
from gyrorig_solver.fleet.jobs.session_job import SolveSettings
from gyrorig_solver.fleet.jobs.workers import local_pools

__all__ = [
    "BatchSummary",
    "SolveSettings",
    "local_pools",
    "run_batch",
]
