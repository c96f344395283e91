"""A fleet: every new recording of a spool becomes calibrations in a store, and rows of an index.

What is here: `spool` what there is to do, `task` one recording's work in a worker, `lanes`
workers that may die, `journal` what has been done since the index was last folded, `index`
the Parquet files that are asked, `batch` one night, `shelf` a store looked at, `verifying`
whether it is whole, `manifest` seals, `ledger` all this in a folder or a bucket.
"""
