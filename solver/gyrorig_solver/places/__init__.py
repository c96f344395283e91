"""Where a spool or a store is: a folder of this machine, or a bucket (`s3://`).

What to use when: `choose.place_at` for what a person names; `place.Place` for what both can do;
`folder` and `bucket` are the two.
"""
