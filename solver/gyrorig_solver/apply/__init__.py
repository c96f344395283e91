"""Calibrations put to use: readings in, true rates out.

What to use when: `Calibration` from Python, arrays in and arrays out; `tables.apply_to_table`
for a CSV file; `recordings.apply_to_recording` for a recording. `correction` says what of a
document can be applied to a reading and what cannot, `affine` is the arithmetic.
"""
