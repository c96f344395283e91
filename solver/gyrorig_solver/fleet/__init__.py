"""Fleet: nightly calibration of many boards, with an index, statistics and a page.

`jobs` solves every new recording of a spool folder, `store` keeps calibrations and their index,
`drift` computes the statistics, `page` shows them, and `column_units` has the names and units of
the index's columns. The commands are `gyrorig batch`, `gyrorig store` and `gyrorig fleet`.
"""
