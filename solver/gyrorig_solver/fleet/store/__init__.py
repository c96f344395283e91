"""Store of a fleet: calibrations, their index, journals, claims and manifests.

What to use when: `store_queries` to list and rebuild, `store_verification.verify` to check,
`index_rows.IndexRow` for one row of the index, `store_backend` for the index and the claims of a
batch in a folder or a bucket, `manifest` for digests and signatures.
"""
